# SPDX-License-Identifier: GPL-3.0-or-later
"""Fills in docs/results/stability.md and draws its charts, from the answers."""

import numpy as np

from scripts.cycles.lights import true_lighting
from scripts.studies import tables
from scripts.studies.measures import order2
from scripts.studies.stability import charts, scenes, unseen
from scripts.studies.stability.answers import HIDDEN, POOR, Answers
from scripts.studies.stability.axes import AXES
from scripts.studies.stability.methods import BLIND, NAMES
from scripts.studies.stability.run import UNDISTURBED, Task

NEVER = 0
REACHING = "the light at the object's middle"  # as a method of its own
MUCH = 0.1  # of a light, to be worth a word where nothing shows it
WORSE = 1.5  # times the undisturbed error: from here on a disturbance is felt


def write(chosen, given) -> None:
    """Fills in the page's answers, writes the table of all of them and the charts beside it."""
    answers = Answers(chosen, given)
    if not answers.records:
        print("no estimates yet")
        return
    charts.draw_all(given.out.parent / "images", answers)
    table = given.out.with_suffix(".csv")
    _write_csv(table, answers)
    names = ", ".join(f"'{scenes.light_name(light)}'" for light in given.lights)
    title = f"{len(answers.methods)} methods, {len(answers.names)} axes: error against severity"
    parts = [
        f"{len(chosen)} objects under {len(given.lights)} lights ({names}), {given.resolution} x {given.resolution} "
        f"pixels, {given.samples} samples: each figure is of up to {len(answers.pairs)} photographs. A failure is an "
        f"error above {POOR:g}; it is hidden where nothing was said anew and the error is more than {HIDDEN:g} times "
        "the stated one.",
        *("## In short", _short(answers), _behind(answers, given.work), _overview(answers), _undisturbed(answers)),
        _picture("stability", title),
        "*Lines are medians; the band is the middle half of ours, the dashed line the error that ours states. "
        "What lies above a picture is written at its edge.*",
        *("## Axis by axis", *(_section(answers, name) for name in answers.names), "## The other measures"),
        *(_picture(name, words) for name, (_, words, *_) in charts.MEASURES.items() if name != "stability"),
        _picture("stability-coverage", "Share of the truth inside the stated intervals"),
        _picture("stability-warnings", "Share of the photographs that were warned of"),
    ]
    tables.fill(given.out, "answers", "\n\n".join(p.rstrip() for p in parts))
    print(f"{given.out}, {table}")


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
        felt = {name: _felt(answers, name) for name in answers.names}
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


def _behind(answers, work) -> str:
    """What of the light lights no face that the camera sees, and what not to know it would cost."""
    lines = []
    for scene, light in answers.pairs:
        folder = scenes.geometry_folder(work, scene, scenes.AS_IS)
        if not (folder / "job.json").exists():
            continue
        share, error = unseen.share_and_error(folder, light)
        if share > MUCH:
            ours = answers.records.get((Task(UNDISTURBED, 0, scene, light), "ours"))
            beside = f"; ours errs {_number(ours['order2'])}" if ours else ""
            lines.append(
                f"- Of *{scenes.light_name(light)}* {_percent(share)} comes from where it lights no face of the "
                f"*{scene.name}*'s mesh that the camera sees: who knew all the rest exactly, and that for dark, would "
                f"err {_number(error)} undisturbed{beside}."
            )
    return "\n".join(lines)


def _felt(answers, axis):
    """The first severity from which on the median error of ours exceeds WORSE times the undisturbed one.

    NEVER where it does not; None where estimates are missing.
    """
    zero, *e = answers.series(axis, "ours", "order2")
    if not np.isfinite([zero, *e]).all():
        return None
    return next((i for i, error in enumerate(e, 1) if error > WORSE * zero), NEVER)


def _overview(answers) -> str:
    """Undisturbed, middle and worst severity of every axis and method."""
    rows = []
    for name in answers.names:
        medians = [answers.series(name, m, "order2")[[0, 3, 5]] for m in answers.methods]
        texts = [" · ".join(map(_number, values)) for values in medians]
        worst = np.array([v[2] for v in medians])
        least = np.isfinite(worst).any() and worst == np.nanmin(worst)
        rows.append(
            (
                name,
                *(f"**{t}**" if best else t for t, best in zip(texts, np.broadcast_to(least, len(texts)), strict=True)),
            )
        )
    heads = ("axis", *(NAMES[m].split(" (")[0] for m in answers.methods))
    table = tables.table(heads, rows)
    return (
        f"Median error at no, middle and worst severity:\n\n{table}\n\nBold: the smallest error at the worst severity."
    )


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
    rows = []
    for method in answers.methods:
        cells = []
        for key in measures:
            form = "{:.0f}" if key in ("direction", "psnr") else "{:.2f}"
            values = answers.values(UNDISTURBED, 0, method, key)
            cells.append(tables.spread(values, form, between=" / {}", far=np.min if key == "psnr" else np.max))
        rows.append((NAMES[method], *cells))
    table = tables.table(("method", *measures.values()), rows)
    return f"Undisturbed, median / worst (spheres: si-RMSE; band-limited, not those of publications):\n\n{table}"


def _section(answers, name: str) -> str:
    """One axis: its tables and what they say."""
    axis, rows = AXES[name], []
    for method in answers.methods:
        refused = [answers.refused(name, i, method) for i in range(6)]
        medians = map(_number, answers.series(name, method, "order2"))
        rows.append(
            (NAMES[method], *(t + (f" ({n} refused)" if n else "") for t, n in zip(medians, refused, strict=True)))
        )
    if "ours" in answers.methods:
        kinds = (
            ("*ours:* worst", "order2", np.max, _number),
            ("stated", "stated", np.median, _number),
            ("direction °", "direction", np.median, lambda v: f"{v:.0f}"),
            *((words, key, np.mean, _percent) for words, key in
              (("68 %", "within68"), ("95 %", "within95"), ("95 % range", "inside"))),
        )  # fmt: skip
        rows += [(words, *map(form, answers.series(name, "ours", key, of=of))) for words, key, of, form in kinds]
        said = ["{} of {}".format(*answers.warned(name, 0, "ours"))]
        for i in range(1, 6):
            (count, total), (anew, _) = (answers.warned(name, i, "ours", anew=a) for a in (False, True))
            said.append(f"{count} of {total}, {anew} anew")
        rows.append(("warned", *said))
    if axis.reaching is not None:
        rows.append((f"*{REACHING}*", _number(0.0), *(_number(_of_reaching(answers, axis, v)) for v in axis.values)))
    table = tables.table((axis.label, "none", *(f"{v:g}" for v in axis.values)), rows)
    words = f"{axis.words}. {_words(answers, name)}"
    return f"### {name[0].upper()}{name[1:]}\n\n{words}\n\n{table}"


def _of_reaching(answers, axis, value) -> float:
    """The median error of who knows the light that reaches the object, and nothing of the one that is asked for."""
    asked = [light for _, light in answers.pairs]
    return float(np.median([order2(axis.reaching(l, value), true_lighting(l, scenes.ORDER)) for l in asked]))


def _words(answers, name: str) -> str:
    """What fails where, in sentences made of the figures."""
    axis, out = AXES[name], []
    errors = {m: answers.series(name, m, "order2") for m in answers.methods}
    if "ours" in errors and np.isfinite(errors["ours"]).all():
        felt, ours = _felt(answers, name), errors["ours"]
        if felt == NEVER:
            out.append(
                f"Ours is not moved beyond {WORSE:g} times its error ({_number(ours[0])} to {_number(max(ours))})."
            )
        else:
            out.append(
                f"Ours passes {WORSE:g} times its undisturbed error ({_number(ours[0])}) at {axis.values[felt - 1]:g} "
                f"and ends at {_number(ours[5])}, where it states {_number(answers.middle(name, 5, 'ours', 'stated'))}."
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
    rows = []
    for (task, method), record in answers.records.items():
        asked = {"axis": task.axis, "index": task.index, "value": "" if task.value is None else task.value}
        asked |= {"scene": task.scene.name, "light": scenes.light_name(task.light), "method": method}
        told = {k: v for k, v in record.items() if k not in ("task", "scale")}
        rows.append(asked | told | {"warnings": " | ".join(record["warnings"])})
    fields = dict.fromkeys(key for row in rows for key in row)
    tables.write_csv(path, rows, list(fields))
