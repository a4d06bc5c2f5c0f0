# SPDX-License-Identifier: GPL-3.0-or-later
"""Results in words, for people."""

from collections import Counter


def estimate(result: dict) -> str:
    """What an estimate found."""
    lines = [_object_line(o) for o in result["objects"]]
    if len(result["photos"]) > 1:
        each = ", ".join(f"{p['job']} {p['exposure']:.3g}" for p in result["photos"])
        lines.append(f"{len(result['photos'])} photos together; exposures: {each}")
    lines.append(f"light of order {result['order']}: {result['determined']}")
    if result["expected_error"]:
        errors = [f"{v['median']:.2f} up to {k.replace('_', ' ')}" for k, v in result["expected_error"].items()]
        lines.append(f"expected error: {', '.join(errors)} (relative, one free scale)")
    if result.get("expected_error_shown"):
        errors = [f"{v['median']:.2f} up to {k.replace('_', ' ')}" for k, v in result["expected_error_shown"].items()]
        lines.append(f"of the light that reaches the photo, past what stands around: {', '.join(errors)}")
    lines.append(
        f"residual {result['residual']:.3f}, condition number {result['condition_number']:.0f}, "
        f"{result['seconds']['total']:.1f} s"
    )
    if "by evidence" in result["choice"].get("curve", ""):
        lines.append(result["choice"]["curve"])
    made = result.get("transport", {})
    if made.get("by") == "reference":
        lines.append(
            f"basis images by the reference: {made['samples']} paths, noise {100 * made['relative_noise']:.1f} %, "
            f"{made['seconds_per_light']:.1f} s a light"
        )
    lines.append(f"results in {result['out']}")
    return "\n".join(lines)


def align(result: dict) -> str:
    """What an alignment did."""
    how = "the geometry was " * result["aligned"] + result["why"]
    if result["depth_shift"] is not None and result["aligned"]:
        right, down = result["depth_shift"]
        how += f"\nby {right:+.1f} pixels to the right and {down:+.1f} down in the picture"
    elif result["aligned"]:
        how += (
            f"\nby {result['moved_px']:.1f} pixels in the picture; the camera turned by {result['degrees']:.1f}° about "
            f"the objects, the focal length changed by {result['focal_percent']:+.1f} %"
        )
    return f"{how}\nresults in {result['out']}"


def recognise(result: dict) -> str:
    """The candidates of every object."""
    lines = []
    for found in result["objects"]:
        lines.append(_object_line(found))
        lines += [f"    {c['score']:.2f}  {c['name']}" for c in found["candidates"][:5]]
    return "\n".join(lines)


def _object_line(record: dict) -> str:
    how = "recognised" if record["recognised"] else "given"
    doubt = " (like none of the library)" if record["unknown"] else ""
    return f"{record['name']}: {record['material']} ({how}){doubt}"


def train(result: dict) -> str:
    """How well each recogniser does on lights that it was not trained with."""
    return "\n".join(
        f"{o['name']}: {o['materials']} materials, accuracy under held-out lights {o['held_out_accuracy']:.2f}"
        for o in result["objects"]
    )


def doctor(result: dict) -> str:
    """What works, a line each."""
    return "\n".join(f"{name:<14} {value}" for name, value in result["facts"].items())


def compare(result: dict) -> str:
    """Error measures, a line each, and what the two lights have to say of one another."""
    found = result.get("agreement")
    if found is None:
        return facts(result)
    told = f"they differ by {100 * found['difference']:.0f} % up to order {found['order']}, "
    told += f"{100 * found['stated']:.0f} % is what they state"
    if found["degrees"] is not None:
        told += f"; by {found['degrees']:.1f}° in their main direction, {found['stated_degrees']:.1f}° is stated"
    verdict = "the two agree" if found["agree"] else "the two DISAGREE: something that one of them assumes is wrong"
    return f"{facts(result)}\n{verdict} ({told})"


def facts(result: dict, indent: str = "") -> str:
    """Any plain result as indented lines."""
    lines = []
    for key, value in result.items():
        if isinstance(value, dict):
            lines += [f"{indent}{key}:", facts(value, indent + "    ")]
        elif isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
            rows = (", ".join(f"{name} {_number(v)}" for name, v in each.items()) for each in value)
            lines += [f"{indent}{key}:", *(f"{indent}    {row}" for row in rows)]
        elif isinstance(value, list | tuple):
            lines.append(f"{indent}{key}: " + ", ".join(_number(v) for v in value))
        else:
            lines.append(f"{indent}{key}: {_number(value)}")
    return "\n".join(lines)


def _number(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def imported(result: dict) -> str:
    """What an import has put into the library."""
    h, w = result["texels"]
    found = result["reciprocity"]
    size = f"{w * result['texel_mm']:.3g} x {h * result['texel_mm']:.3g} mm"
    return (
        f"{result['name']}: {w} x {h} texels, {size}, {result['components']} components, "
        f"{result['size'] / 1e6:.1f} MB\n"
        f"cosine {result['cosine']} in the data (reciprocity error {found['as_stored']:.2f} as stored, "
        f"{found['divided']:.2f} divided by the cosine: {found['verdict']})"
    )


def checked(results: list) -> str:
    """A line for each material that was looked over."""
    lines = []
    for r in results:
        facts = f"albedo {r['albedo'][0]:.2f} to {r['albedo'][1]:.2f}" if "albedo" in r else "could not be read"
        if "reciprocity_error" in r:
            facts += f", reciprocity error {r['reciprocity_error']:.3f}"
        lines.append(f"{'good' if r['ok'] else 'BAD ':<5} {r['name']:<32} {facts}")
    return "\n".join(lines)


def plan(result: dict) -> str:
    """What a plan found."""
    lines = [f"{o['name']}: {o['material']}, {o['pixels']} pixels" for o in result["objects"]]
    text = result["determined"].replace("the photo", "a photo")
    lines.append(f"{text} ({result['effective_degrees_of_freedom']:.0f} effective degrees of freedom)")
    for key, error in result["expected_error"].items():
        lines.append(
            f"expected error up to {key.replace('_', ' ')}: {error['median']:.2f} "
            f"({error['low']:.2f} to {error['high']:.2f}), one free scale"
        )
    lines.append(
        f"condition number {result['condition_number']:.0f} at order {result['order']}, assumed misfit "
        f"{100 * result['assumed_noise']:.0f} %"
    )
    lines += [f"advice: {a}" for a in result["advice"]]
    lines.append(f"results in {result['out']}")
    return "\n".join(lines)


def sequence(result: dict) -> str:
    """What a sequence gave."""
    lines = [f"{o['name']}: {o['material']}" for o in result["objects"]]
    lines += [f"{f['image']}: residual {f['residual']:.3f}, {f['determined']}" for f in result["frames"]]
    lines += [f"{f['image']}: no light; {f['message']}" for f in result.get("failed", ())]
    found = Counter(f["by"] for f in result["frames"])
    lines.append(
        f"{len(result['frames'])} lights of order {result['order']} "
        f"({', '.join(f'{how} {count} times' for how, count in found.items())}), "
        f"{result['median_milliseconds_per_further_frame']:.1f} ms for a further one, "
        f"{result['seconds']['total']:.1f} s in all"
    )
    lines.append(f"results in {result['out']}")
    return "\n".join(lines)


def chart(result: dict) -> str:
    """A line for each point, the fastest first; * marks the front."""
    lines = [f"error of order 2 against the {result['reference']}; seconds of transport and fit"]
    for p in sorted(result["points"], key=lambda p: p["seconds"]):
        ratio = f"  {p['paper_ratio']:8.0f} x" if p["paper_ratio"] else ""
        lines.append(f"{'*' if p['front'] else ' '} {p['seconds']:9.3f} s  {p['error']:7.3f}{ratio}  {p['name']}")
    if any(p["paper_ratio"] for p in result["points"]):
        lines.append("x: how many times the paper's path tracing takes as long, in this run")
    lines.append(f"wrote {result['chart']}")
    return "\n".join(lines)
