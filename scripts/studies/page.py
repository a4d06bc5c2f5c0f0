# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes docs/stability.md and its charts from the answers."""

import csv

import numpy as np

from btfsep_engine.atomic import write_text
from scripts.studies import charts, scenes
from scripts.studies.axes import AXES
from scripts.studies.methods import BLIND, NAMES
from scripts.studies.run import UNDISTURBED
from scripts.studies.summary import HIDDEN, POOR, Answers, light_words

NEVER = 0
WORSE = 1.5  # times the undisturbed error: from here on a disturbance is felt
CSV_FIELDS = (
    "axis", "index", "value", "scene", "light", "method", "refused", "order1", "order2", "order1_absolute",
    "order2_absolute", "direction", "diffuse_si_rmse", "silver_si_rmse", "mirror_si_rmse", "diffuse_degrees",
    "silver_degrees", "mirror_degrees", "psnr", "stated", "within68", "within95", "inside", "warnings", "seconds",
)  # fmt: skip

HOW = """\
Seven methods are asked for the light of the same photographs, which are disturbed in {axes} ways, each five times
more severely. What is photographed are {scenes} objects under {lights} of Blender's studio lights ({names}), none of
them used in any tuning: Cycles, {resolution} x {resolution} pixels, {samples} samples, materials as true displaced
geometry with other texels than the library's. Each point below is the median of up to {photos} photographs.

Written by `scripts/study_stability --work FOLDER`; every photograph and every method is a row of `{csv}`.

| method | what it is told | what it does |
|---|---|---|
| ours | geometry, material | the engine's default estimator |
| paper, BTF | geometry, material | least squares of order 4 (Weinmann et al. 2016, eq. 11) on renderings with the \
BTF, of eight reflections as ours |
| paper, mean ABRDF | geometry, material | the same with the mean ABRDF: `--preset paper` |
| paper, order cross-validated | geometry, material | the same at the order that block cross-validation chooses |
| Lambertian, order 2 | geometry | the irradiance formula of Ramamoorthi and Hanrahan 2001, no shadows, albedo of the \
photo's mean colour |
| alternating | geometry | weights of four basis BRDFs and Haar wavelets of the light, in turns, after Haber et al. \
2009 |
| joint parametric | geometry | one diffuse and glossy BRDF and the light at once, minimum-entropy and heavy-tailed \
gradient priors, after Lombardi and Nishino 2012, 2016 |

The last three are the study's own implementations (`scripts/studies`), simplified where one photograph does not
determine more, and each is tested to succeed on data of its own model (`tests/engine/test_baselines.py`). They are not
told the material, which is a harder task: what they lose by it is part of the comparison, and they cannot be misled by
a wrong one. All three take the light's mean colour to be grey.

Errors are relative L2 errors of the coefficients up to order 2 with one free scale. **Stated** is the error that the
estimate itself expects (of the paper's rows: its standard deviations over its size); **68 %, 95 %** is the share of the
true coefficients within 1 and 1.96 stated standard deviations, without any free scale, **95 % range** that inside the
stated range, which is lopsided; **warned** counts photographs of which the method said anything,
**anew** those of which it said what it had not said of the same photograph undisturbed. The methods of the study
itself state nothing and never warn. A failure is an error above {poor:g}; it is hidden where nothing was said anew and
the error is more than {hidden:g} times the stated one.
"""


def write(chosen, options) -> None:
    """Writes the page, the table of all answers and the charts beside it."""
    answers = Answers(chosen, options)
    if not answers.records:
        print("no estimates yet")
        return
    drawn = charts.draw_all(options.out.parent / "images", answers, chosen, options)
    table = options.out.with_suffix(".csv")
    _write_csv(table, answers)
    parts = [
        "# Stability",
        HOW.format(
            axes=len(answers.names),
            scenes=len(chosen),
            lights=len(options.lights),
            names=light_words(options.lights),
            resolution=options.resolution,
            samples=options.samples,
            photos=len(answers.pairs),
            csv=table.name,
            poor=POOR,
            hidden=HIDDEN,
        ),
    ]
    if "stability-photos" in drawn:
        parts.append(_picture("stability-photos", "What is photographed, undisturbed and disturbed"))
    parts += ["## In short", _short(answers), _overview(answers), _undisturbed(answers)]
    parts.append(
        _picture("stability", f"{len(answers.methods)} methods, {len(answers.names)} axes: error against severity")
    )
    parts.append(
        "*Lines are medians; the band is the middle half of ours, the dashed line the error that ours states. "
        "What lies above a picture is written at its edge.*"
    )
    parts += ["## Axis by axis", *(_section(answers, name) for name in answers.names)]
    parts.append("## The other measures")
    for name, (_, title, *_) in charts.MEASURES.items():
        if name != "stability":
            parts.append(_picture(name, title))
    parts.append(_picture("stability-coverage", "Share of the truth inside the stated intervals"))
    parts.append(_picture("stability-warnings", "Share of the photographs that were warned of"))
    write_text(options.out, "\n\n".join(p.rstrip() for p in parts) + "\n")
    print(f"{options.out}, {table}, {len(drawn)} charts")


def _picture(name: str, words: str) -> str:
    return f"![{words}](images/{name}.png)"


def _number(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.2f}" if value < 10 else f"{value:.0f}"


def _percent(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{100 * value:.0f} %"


def _short(answers) -> str:
    """What the figures say, in words."""
    lines = []
    if "ours" in answers.methods:
        felt = {name: _felt(answers, name, "ours") for name in answers.names}
        unmoved = [n for n, i in felt.items() if i == NEVER]
        early = [f"{n} (from {AXES[n].values[i - 1]:g})" for n, i in felt.items() if i in (1, 2)]
        if unmoved:
            lines.append(f"- Ours stays within {WORSE:g} times its undisturbed error on: {', '.join(unmoved)}.")
        if early:
            lines.append(f"- It is felt early, at the first or second severity, on: {', '.join(early)}.")
        rows = [r for n in answers.names for i in range(1, 6) for r in answers.of(n, i, "ours")]
        rows = [r for r in rows if r.get("within95") is not None]
        if rows:
            inside = [np.mean([r[k] for r in rows]) for k in ("within68", "within95")]
            lines.append(
                f"- Over all disturbed photographs the truth lies in ours' 68 % and 95 % intervals for "
                f"{_percent(inside[0])} and {_percent(inside[1])} of the coefficients."
            )
    totals = {m: np.sum([answers.failures(n, m) for n in answers.names], axis=0) for m in answers.methods}
    for method, (bad, hidden, already, total) in totals.items():
        if total:
            said = "" if method in BLIND else f", {hidden} of them hidden"
            lines.append(
                f"- {NAMES[method]}: {bad} failures in {total} answers ({100 * bad / total:.0f} %), {already} of them "
                f"on photographs that fail undisturbed too{said}."
            )
    return "\n".join(lines)


def _felt(answers, axis, method):
    """The first severity from which on the median error exceeds WORSE times the undisturbed one.

    NEVER where it does not; None where estimates are missing.
    """
    zero = answers.median(axis, 0, method, "order2")
    errors = [answers.median(axis, i, method, "order2") for i in range(1, 6)]
    if not np.isfinite([zero, *errors]).all():
        return None
    over = [i for i, e in enumerate(errors, 1) if e > WORSE * zero]
    return over[0] if over else NEVER


def _overview(answers) -> str:
    """Undisturbed, middle and worst severity of every axis and method."""
    lines = ["Median error at no, middle and worst severity:", ""]
    lines += ["| axis | " + " | ".join(NAMES[m].split(" (")[0] for m in answers.methods) + " |"]
    lines += ["|---|" + "---|" * len(answers.methods)]
    for name in answers.names:
        medians = {m: [answers.median(name, i, m, "order2") for i in (0, 3, 5)] for m in answers.methods}
        worst = [v[2] for v in medians.values() if np.isfinite(v[2])]
        cells = []
        for values in medians.values():
            text = " · ".join(_number(v) for v in values)
            cells.append(f"**{text}**" if worst and values[2] == min(worst) else text)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", "Bold: the smallest error at the worst severity."])


def _undisturbed(answers) -> str:
    """Every measure of the undisturbed photographs."""
    measures = {
        "order1": "order 1",
        "order2": "order 2",
        "order2_absolute": "order 2, no scale",
        "direction": "direction °",
        "diffuse_si_rmse": "diffuse sphere",
        "silver_si_rmse": "silver sphere",
        "mirror_si_rmse": "mirror sphere",
        "psnr": "PSNR, dB",
    }
    lines = [
        "Undisturbed, median / worst (spheres: si-RMSE; band-limited, not those of publications):",
        "",
        "| method | " + " | ".join(measures.values()) + " |",
    ]
    lines.append("|---|" + "---|" * len(measures))
    for method in answers.methods:
        cells = []
        for key in measures:
            values = answers.values(UNDISTURBED, 0, method, key)
            worst = values.min() if key == "psnr" and len(values) else values.max() if len(values) else np.nan
            middle = np.median(values) if len(values) else np.nan
            form = (lambda v: "–" if not np.isfinite(v) else f"{v:.0f}") if key in ("direction", "psnr") else _number
            cells.append(f"{form(middle)} / {form(worst)}")
        lines.append(f"| {NAMES[method]} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _section(answers, name: str) -> str:
    """One axis: its tables and what they say."""
    axis = AXES[name]
    heads = ["none", *(f"{v:g}" for v in axis.values)]
    lines = [
        f"### {name[0].upper()}{name[1:]}",
        "",
        f"{axis.words[0].upper()}{axis.words[1:]}. {_words(answers, name)}",
        "",
    ]
    lines += [f"| {axis.label} | " + " | ".join(heads) + " |", "|---|" + "---|" * 6]
    for method in answers.methods:
        cells = []
        for i in range(6):
            text = _number(answers.median(name, i, method, "order2"))
            refused = answers.refused(name, i, method)
            cells.append(text + (f" ({refused} refused)" if refused else ""))
        lines.append(f"| {NAMES[method]} | " + " | ".join(cells) + " |")
    if "ours" in answers.methods:
        of = lambda key, form, pick: [form(pick(name, i, "ours", key)) for i in range(6)]  # noqa: E731
        lines.append("| *ours:* worst | " + " | ".join(_worst(answers, name, i) for i in range(6)) + " |")
        lines.append("| stated | " + " | ".join(of("stated", _number, answers.median)) + " |")
        lines.append("| direction ° | " + " | ".join(of("direction", lambda v: f"{v:.0f}", answers.median)) + " |")
        lines.append("| 68 % | " + " | ".join(of("within68", _percent, answers.mean)) + " |")
        lines.append("| 95 % | " + " | ".join(of("within95", _percent, answers.mean)) + " |")
        lines.append("| 95 % range | " + " | ".join(of("inside", _percent, answers.mean)) + " |")
        zero = answers.of(name, 0, "ours")
        said = [f"{sum(bool(r['warnings']) for r in zero)} of {len(zero)}"]
        for i in range(1, 6):
            (count, total), (anew, _) = (answers.warned(name, i, "ours", anew=a) for a in (False, True))
            said.append(f"{count} of {total}, {anew} anew")
        lines.append("| warned | " + " | ".join(said) + " |")
    return "\n".join(lines)


def _worst(answers, name, index) -> str:
    values = answers.values(name, index, "ours", "order2")
    return _number(values.max()) if len(values) else "–"


def _words(answers, name: str) -> str:
    """What fails where, in sentences made of the figures."""
    axis, out = AXES[name], []
    errors = {m: [answers.median(name, i, m, "order2") for i in range(6)] for m in answers.methods}
    if "ours" in errors and np.isfinite(errors["ours"]).all():
        felt = _felt(answers, name, "ours")
        ours = errors["ours"]
        if felt == NEVER:
            out.append(
                f"Ours is not moved beyond {WORSE:g} times its error ({_number(ours[0])} to {_number(max(ours))})."
            )
        else:
            out.append(
                f"Ours passes {WORSE:g} times its undisturbed error ({_number(ours[0])}) at {axis.values[felt - 1]:g} "
                f"and ends at {_number(ours[5])}, where it states {_number(answers.median(name, 5, 'ours', 'stated'))}."
            )
        bad, hidden, already, total = answers.failures(name, "ours")
        if bad:
            out.append(f"Of its {total} answers {bad} fail ({already} did undisturbed), {hidden} of them hidden.")
        better = [m for m in errors if m != "ours" and errors[m][5] < 0.9 * ours[5]]
        if better:
            out.append("At the worst severity better: " + _listed(errors, better) + ".")
    fallen = [m for m in errors if m != "ours" and errors[m][5] > max(POOR, WORSE * errors[m][0])]
    if fallen:
        out.append("Brought down by it: " + _listed(errors, fallen) + ".")
    return " ".join(out)


def _listed(errors, names) -> str:
    return ", ".join(f"{NAMES[m].split(' (')[0]} ({_number(errors[m][0])} to {_number(errors[m][5])})" for m in names)


def _write_csv(path, answers) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, CSV_FIELDS, extrasaction="ignore")
        writer.writeheader()
        for (task, method), record in answers.records.items():
            zero = AXES[task.axis].zero if task.axis != UNDISTURBED else None
            row = {
                **record,
                "axis": task.axis,
                "index": task.index,
                "value": (zero if zero is not None else "")
                if task.index == 0
                else AXES[task.axis].values[task.index - 1],
                "scene": task.scene.name,
                "light": scenes.light_name(task.light),
                "method": method,
                "warnings": " | ".join(record["warnings"]),
            }
            writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})
