# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/speed-accuracy.md."""

PRESETS = ("draft", "balanced", "accurate")


def page(points, *, count: int, total: int, lights, paper: int, samples: int) -> str:
    """The Markdown page.

    Parameters
    ----------
    points : list of summary.MeanPoint
    count : photographs; total : of so many; lights : names of the lights that they are under
    paper : how many of them the paper's way was tried on; samples : of its path tracing
    """
    anew = [p.name for p in points if p.anew]
    lines = [
        "# Speed against accuracy",
        "",
        f"Geometric means over {count} of {total} photographs by Cycles of displaced objects under Blender's own "
        f"studio lights ({', '.join(lights)}); the material given. One setting at a time is changed "
        "from `balanced`. Seconds are of "
        "transport and fit, warm, all ways of a photo in one process, one after the other; the error is of the "
        'coefficients up to order 2 with one free scale. "Over balanced" is on the same photo, with its standard '
        f"error. The last row is the paper's way, of {paper} of the photos: one path-traced image for each basis "
        f'light, {samples} samples a pixel, plain least squares of order 4; "paper\'s time" is its time over this '
        "way's, of the same photo in the same process. Made by `scripts/study_speed_accuracy PHOTOS --count "
        f"{count} --paper {paper}`, `PHOTOS` being what `scripts/figures_table --photos` leaves; for one job: "
        "`btfsep chart JOB`."
        + (f" Measured again in a later run, beside `balanced` (`--anew`): {', '.join(anew)}." if anew else ""),
        "",
        "![error against seconds for every setting, with the Pareto front](images/speed-accuracy.png)",
        "",
        'Front: **yes** where no other way is both faster and more accurate in the mean; "within noise" where another '
        "is, but not by more than a standard error in both.",
        "",
        "| what is changed | how | seconds | error: mean / worst | over balanced | direction ° | paper's time | front "
        "|",
        "|---|---|---|---|---|---|---|---|",
    ]
    for p in sorted(points, key=lambda p: p.seconds):
        name = f"**{p.name}**" if p.axis == "preset" else p.name
        front = "**yes**" if p.front else "" if p.beaten else "within noise"
        ratio = "" if p.paper_ratio is None else f"{p.paper_ratio:.0f}"
        lines.append(
            f"| {p.axis} | {name} | {p.seconds:.3f} | {p.error:.3f} / {p.worst:.2f} | {p.ratio:.2f} ± "
            f"{p.ratio * p.spread:.2f} | {p.direction:.0f} | {ratio} | {front} |"
        )
    return "\n".join([*lines, "", presets_words(points)]) + "\n"


def presets_words(points) -> str:
    """The presets in a sentence."""
    presets = {p.name: p for p in points if p.axis == "preset"}
    base = presets["balanced"]
    said = [
        f"{name} {presets[name].seconds:.2f} s, error {presets[name].error:.3f} "
        f"({presets[name].ratio:.2f} ± {presets[name].ratio * presets[name].spread:.2f} of balanced's, "
        f"{presets[name].seconds / base.seconds:.2f} of its time)"
        for name in PRESETS
    ]
    return f"The presets: {'; '.join(said)}."
