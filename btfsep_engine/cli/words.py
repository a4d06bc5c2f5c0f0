# SPDX-License-Identifier: GPL-3.0-or-later
"""Results in words, for people."""


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


def recognise(result: dict) -> str:
    """The candidates of every object."""
    lines = []
    for found in result["objects"]:
        lines.append(_object_line(found))
        lines += [f"    {c['score']:.2f}  {c['name']}" for c in found["candidates"][:5]]
    return "\n".join(lines)


def _object_line(found: dict) -> str:
    how = "recognised" if found["recognised"] else "given"
    doubt = " (like none of the library)" if found["unknown"] else ""
    return f"{found['name']}: {found['material']} ({how}){doubt}"


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
    """Error measures, a line each."""
    return facts(result)


def facts(result: dict, indent: str = "") -> str:
    """Any plain result as indented lines."""
    lines = []
    for key, value in result.items():
        if isinstance(value, dict):
            lines += [f"{indent}{key}:", facts(value, indent + "    ")]
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
