# SPDX-License-Identifier: GPL-3.0-or-later
"""How often the material is recognised, how sure it is said to be, and whether what is not known is said to be so.

scripts/study recognition FOLDER                    250 photographs by Cycles, taken into FOLDER unless they are there
scripts/study recognition FOLDER --no-take --flaws clean small noisy jpeg blurred grey scaled "all three"
scripts/study recognition FOLDER --light            the error of the light, too, with the sets, with the true material

Five objects, each in six of the library's materials, under six of Blender's studio lights; meso-structure as displaced
geometry with other texels than the library's and another UV map. No object and no light of theirs is among those on
which the weights and the sets' size were learned (`scripts/study learn-recognition`). The same objects and lights, with
surfaces that are alike all over, are what the library has nothing of; mirrors of the same shapes are its chrome. The
answers are those of an estimate with the same preset; plain surfaces and mirrors are not asked of single flaws. Shares
come with the range that holds the true one with 95 % (Wilson's, as if photos were independent; those of one object in
one material are not quite).
"""

import itertools
import json
import time
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.stats import binomtest, rankdata

from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.verification import PLAIN
from btfsep_engine.recognise.judgement import judgements
from scripts.studies import ROOT, cues, measures, parser, photos, tables
from scripts.studies.estimates import scene_of
from scripts.studies.photos import WHITE

OBJECTS = ("knot", "vase", "pebble", "cushion", "sphere")
LIGHTS = ("courtyard", "forest", "interior", "night", "studio", "sunset")
OBJECTS_EACH, LIGHTS_EACH = 2, 5  # of a material
SHOWN_PLAIN = (  # of which the library has nothing
    *("plain/satin-teal", "plain/satin-white", "plain/gloss-green", "plain/gloss-white"),
    *("plain/metal-yellow", "plain/metal-white", "plain/matte-teal", "plain/matte-yellow"),
)
SHOWN_MIRRORS, MIRROR = ("plain/mirror-white", "plain/mirror-grey"), "reference/chrome"
# white paint is white paint, by whichever name; and no mirror
PLAIN_CLASSES = {"reference/white-diffuse": "matte", "surface/matte": "matte", "reference/chrome": "mirror"}
RESOLUTION, SAMPLES = 256, 64
BINS, FEWEST = 10, 5  # of the calibration; photographs of one that is drawn
PICTURES = ROOT / "docs" / "results" / "images"


def shots(folder: Path, materials) -> list:
    """The photographs of the evaluation: those of an object in a material stand together."""
    out = []
    for turn, (j, material), k in itertools.product(range(OBJECTS_EACH), enumerate(materials), range(LIGHTS_EACH)):
        light = LIGHTS[(j + turn + k) % len(LIGHTS)]
        out.append(photos.shot(folder, OBJECTS[(j + 2 * turn) % len(OBJECTS)], photos.studio_name(material), light))
    return out


def share(right) -> str:
    """The share of true values and the range that holds it with 95 %."""
    right = [bool(r) for r in right]
    if not right:
        return "none asked"
    low, high = binomtest(sum(right), len(right)).proportion_ci(method="wilson")
    return f"{np.mean(right):.1%} ({100 * low:.0f} to {100 * high:.0f})"


def area_under(higher, lower) -> float:
    """The share of pairs in which the value of ``higher`` is larger (AUROC)."""
    ranks = rankdata(np.concatenate([higher, lower]))[: len(higher)]
    return float((ranks.sum() - len(higher) * (len(higher) + 1) / 2) / (len(higher) * len(lower)))


def calibration(confidence, right) -> tuple[float, list]:
    """The expected calibration error in `BINS` bins, and (mean confidence, share right, number) of those in use."""
    confidence, right = np.asarray(confidence), np.asarray(right, np.float64)
    number = np.minimum((confidence * BINS).astype(int), BINS - 1)
    bins = [(confidence[number == b].mean(), right[number == b].mean(), (number == b).sum()) for b in np.unique(number)]
    return float(sum(n * abs(c - r) for c, r, n in bins) / len(right)), bins


def by_chance(confidence) -> tuple[float, float]:
    """The middle 90 % of the expected calibration errors of photographs of which the confidence is right."""
    confidence, random = np.asarray(confidence), np.random.default_rng(0)
    drawn = [calibration(confidence, random.random(len(confidence)) < confidence)[0] for _ in range(1000)]
    return tuple(np.quantile(drawn, (0.05, 0.95)))


def answers(seen, model: str | None = None) -> list[dict]:
    """What is answered of photographs (cues.Seen), by a model of the table; None: as an estimate chooses it."""
    out = []
    for s in seen:
        judgement = judgements()[model or s.model]
        plain = model != "votes"  # the classifier knows nothing of plain surfaces
        truth, known = s.photograph.material, judgement.answer(*s.of_candidates(plain=plain), plain=PLAIN)
        hidden = s.left_out and judgement.answer(*s.of_candidates(left_out=True, plain=plain), plain=PLAIN)
        order = [name for name, _ in known.candidates]
        out.append(
            {
                "truth": truth,
                "object": s.photograph.object,
                "light": s.photograph.light,
                "answer": known.material,
                "stand_in": known.stand_in,
                "rank": order.index(truth) if truth in order else len(order),
                "confidence": dict(known.candidates)[known.material],
                "likely": known.likely,
                "may_be_plain": any(name in PLAIN for name in known.likely),
                "strangeness": known.unknown_score,
                "left_out": hidden and hidden.unknown_score,
            }
        )
    return out


def of_class(name: str) -> str:
    """The class of a material; of references and of surfaces alike all over, what they are like."""
    return PLAIN_CLASSES.get(name) or name.split("/")[0]


def judge(answers, title: str) -> dict:
    """Prints what came out, and gives the row of the table."""
    right = [a["answer"] == a["truth"] for a in answers]
    same_class = [of_class(a["answer"]) == of_class(a["truth"]) for a in answers]
    stated = [a["confidence"] for a in answers]
    error, bins = calibration(stated, right)
    row = {
        "photos": f"{title} ({len(answers)})",
        "material": share(right),
        "class": share(same_class),
        "first three": share(a["rank"] < 3 for a in answers),
        "in the set": share(a["truth"] in a["likely"] for a in answers),
        "size of the set": f"{np.mean([len(a['likely']) for a in answers]):.2f}",
        "calibration error": "{:.3f} (by chance {:.3f} to {:.3f})".format(error, *by_chance(stated)),
    }
    print(f"\n## {title}: {len(answers)} photos")
    print("; ".join(f"{k} {v}" for k, v in list(row.items())[1:]))
    print("confidence, right, photos:", "; ".join(f"{c:.2f} {r:.2f} {n}" for c, r, n in bins))
    if hidden := [a["left_out"] for a in answers if a["left_out"] is not None]:
        known = [a["strangeness"] for a in answers]
        row["said unknown"] = share(v > 1 for v in hidden)
        row["AUROC"] = f"{area_under(hidden, known):.3f}"
        print(f"its material left out: said unknown {row['said unknown']}; AUROC {row['AUROC']}")
        print(f"known, said unknown: {share(v > 1 for v in known)}")
    for key in ("light", "object"):
        print(f"by {key}: ", end="")
        groups = tables.groups(answers, key, every=None)
        print(
            "; ".join(f"{name} {np.mean([a['answer'] == a['truth'] for a in g]):.0%} of {len(g)}" for name, g in groups)
        )
    print("confusions (truth -> answer: times, of them with the truth in the set)")
    wrong = [a for a in answers if a["answer"] != a["truth"]]
    for (truth, answer), times in Counter((a["truth"], a["answer"]) for a in wrong).most_common():
        held = sum(a["truth"] in a["likely"] for a in wrong if (a["truth"], a["answer"]) == (truth, answer))
        print(f"  {truth} -> {answer}: {times}, {held}")
    return row


def judge_plain(answers, known) -> None:
    """Prints what is said of plain surfaces, of which the library has none, beside answers of its own materials."""
    print(f"\n## plain surfaces: {len(answers)} photos")
    metal = [a for a in answers if "metal" in a["truth"]]
    kinds = {"all but matte": [a for a in answers if "matte" not in a["truth"]]}
    kinds |= dict(tables.groups([a | {"finish": a["truth"].split("-")[0]} for a in answers], "finish", every=None))
    lower = [a["strangeness"] for a in known]
    for kind, some in kinds.items():
        unknown = share(a["stand_in"] is not None for a in some)
        held = share(bool(a["may_be_plain"]) for a in some)
        area = area_under([a["strangeness"] for a in some], lower)
        print(f"{kind}: said unknown {unknown}; plain in the set {held}; AUROC {area:.3f}")
        print("  taken for", Counter(a["stand_in"] or a["answer"] for a in some).most_common(6))
    print("of metal said to be metal:", share("surface/metal" in (a["stand_in"], a["answer"]) for a in metal))


def judge_mirrors(answers) -> None:
    """Prints how many of photographs of mirrors are known as such."""
    right = share(a["answer"] == MIRROR and a["stand_in"] is None for a in answers)
    held = share(MIRROR in a["likely"] for a in answers)
    print(f"\n## mirrors: {len(answers)} photos\nright {right}; in the set {held}")
    print("  taken for", Counter(a["stand_in"] or a["answer"] for a in answers).most_common(6))


def confusion_picture(answers, path: Path) -> None:
    """Rows: what is photographed; columns: what it is taken for."""
    names = sorted({a["truth"] for a in answers} | {a["answer"] for a in answers})
    counts = np.zeros((len(names), len(names)))
    for a in answers:
        counts[names.index(a["truth"]), names.index(a["answer"])] += 1
    made = tables.figure(7.2, 6.4)
    axes = made.subplots()
    axes.imshow(counts / np.maximum(counts.sum(1, keepdims=True), 1), cmap="Blues", vmin=0, vmax=1)
    for i, j in zip(*np.nonzero(counts), strict=True):
        dark = counts[i, j] > 0.6 * counts[i].sum()
        axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7, color="white" if dark else "black")
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.set(xlabel="taken for", ylabel="photographed")
    tables.save(made, path)


def calibration_picture(answers_of: dict, path: Path) -> None:
    """Left: share right over stated confidence; right: share of photos said to be unknown, over the limit."""
    made = tables.figure(8.4, 3.6)
    left, right = made.subplots(1, 2)
    left.plot((0, 1), (0, 1), color="#999999", linewidth=0.8)
    for (flaw, answers), colour in zip(answers_of.items(), tables.COLOURS, strict=False):
        bins = calibration([a["confidence"] for a in answers], [a["answer"] == a["truth"] for a in answers])[1]
        bins = [b for b in bins if b[2] >= FEWEST]
        left.plot([b[0] for b in bins], [b[1] for b in bins], "o-", color=colour, label=flaw, markersize=3, linewidth=1)
        for key, line in (("strangeness", "-"), ("left_out", "--")):
            values = np.sort([a[key] for a in answers if a[key] is not None])
            if len(values):
                shares = 1 - np.arange(len(values)) / len(values)
                right.plot(np.maximum(values, 1e-3), shares, line, color=colour, linewidth=1)
    left.set(xlabel="stated confidence", ylabel="share right", xlim=(0, 1), ylim=(0, 1.02))
    left.legend(fontsize=7, frameon=False)
    right.axvline(1, color="#999999", linewidth=0.8)
    right.set(xscale="log", xlabel="unknown_score (dashed: its material left out)", ylabel="share of photos above")
    for axes in (left, right):
        tables.plain(axes)
    tables.save(made, path)


def light_errors(photographs, library, settings) -> list[dict]:
    """The error of the light with what recognition leaves, and with the true material: one photo of each mesh."""
    out, before = [], None
    for p in photographs:
        if (p.object, p.shown) == before:
            continue
        before = p.object, p.shown
        scene, truth = scene_of(p.folder, uv="xatlas"), p.truth(measures.ERROR_ORDER)
        with_truth, found = (estimate(scene, library, settings, material=name) for name in (p.material, None))
        rows = {"true": with_truth.fit, "first": found.light.fit, "set": found.fit}
        errors = {k: measures.order2(fit.coefficients, truth) for k, fit in rows.items()}
        inside = {k: measures.judged(f, f.samples, truth, free_scale=True)["inside"] for k, f in rows.items()}
        out.append({"photo": p.folder.name, "found": found.materials[0].name, "errors": errors, "inside": inside})
        print(p.folder.name, found.materials[0].name, errors, inside, flush=True)
    return out


def light_words(rows) -> str:
    """The ratio of errors, and how much of the truth the ranges hold."""
    true, found = (np.mean([r["errors"][k] for r in rows]) for k in ("true", "set"))
    inside = [f"{np.mean([r['inside'][k] for r in rows]):.0%}" for k in ("true", "first", "set")]
    return (
        f"error of the light, order 2, of {len(rows)} photos: {true:.3f} with the true material, {found:.3f} with the "
        f"recognised one ({found / true:.2f} times); coefficients inside the stated ranges: {inside[0]} with the true "
        f"material, {inside[1]} with the likeliest alone, {inside[2]} with the set"
    )


def main(arguments) -> int:
    options = parser("recognition", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--no-take", dest="take", action="store_false", help="only photographs that are there")
    options.add_argument("--flaws", nargs="+", default=["clean"], choices=cues.FLAWS)
    options.add_argument("--preset", default="balanced", help="whose training is measured")
    options.add_argument("--light", action="store_true", help="estimates the light of one photo of each object in each")
    options.add_argument("--pictures", action="store_true", help="writes those of docs/results/recognition.md")
    given = options.parse_args(arguments)
    library, settings = open_library(), choose(given.preset)
    wanted = shots(given.folder.resolve(), [WHITE, *library.entries])
    beside = given.folder.resolve() / photos.PLAIN
    every = wanted, shots(beside, SHOWN_PLAIN), shots(beside, SHOWN_MIRRORS)
    if given.take:
        photos.take(list(itertools.chain(*every)), resolution=RESOLUTION, samples=SAMPLES, denoise=True)
    found, plain, mirrors = (cues.seen_in(some) for some in every)
    for some in (found, plain, mirrors):
        some.sort(key=lambda p: OBJECTS.index(p.object))  # an object's training is loaded once
    rows, answers_of = [], {}
    for flaw in given.flaws:
        begun = time.perf_counter()
        seen = cues.cues_of(found, library, settings, flaw=flaw)
        print(f"{flaw}: {time.perf_counter() - begun:.0f} s")
        answers_of[flaw] = answers(seen)
        rows.append(judge(answers_of[flaw], flaw))
        if flaw in cues.SINGLE:
            continue
        if plain:
            judge_plain(answers(cues.cues_of(plain, library, settings, flaw=flaw)), answers_of[flaw])
        if mirrors:
            judge_mirrors(answers(cues.cues_of(mirrors, library, settings, flaw=flaw)))
        if flaw == "clean":
            rows.append(judge(answers(seen, "votes"), "clean, by the classifier alone"))
    flawed = [a for flaw in cues.SINGLE for a in answers_of.get(flaw, ())]
    if flawed:
        rows.append(judge(flawed, "all with one flaw"))
    heads = list(rows[0])
    print("\n" + tables.table(heads, [[row.get(h, "–") for h in heads] for row in rows]))
    (given.folder / "answers.json").write_text(json.dumps(answers_of, indent=1))
    if given.pictures:
        confusion_picture(answers_of[given.flaws[0]], PICTURES / "recognition-confusions.png")
        shown = {flaw: some for flaw, some in answers_of.items() if flaw not in cues.SINGLE}
        calibration_picture(shown | ({"one flaw": flawed} if flawed else {}), PICTURES / "recognition-calibration.png")
    if given.light:
        print(light_words(light_errors(found, library, settings)))
    return 0
