# SPDX-License-Identifier: GPL-3.0-or-later
"""Plates whose things are not those of `scripts.studies.plate_sets.drawn`: what they are, and what jobs say of it."""

import numpy as np

from scripts.cycles import plain
from scripts.cycles.lights import true_lighting
from scripts.studies.plate_light import DIMMED, LAMPS, STRONG, from_in_front

OF_SURFACES = (0.35, 0.3, 0.25, 0.1)
METALS = (
    (0.55, 0.556, 0.554),
    (0.97, 0.96, 0.91),
    (1.0, 0.77, 0.34),
    (0.95, 0.64, 0.54),
)  # chrome, silver, gold, copper
POLISHED = (0.0, 0.1, 0.2)  # roughness
OF_OBJECTS = ("as said", "subsurface", "bumps", "mottled")
OF_CAMERAS = ("clean", "vignette", "grain", "soft", "glare")
PAINT, IN_THE_DARK = (0.3, 0.8), 0.5  # how much of a piece's colour is the paint's; share of plates with lamps alone
# Of scans: least roughness; their sky's radiances below and at the horizon over that above; share in the photo's light
MATTE, BELOW, HORIZON, OWN_LIGHT = 0.5, (0.1, 0.5), (0.4, 1.0), 1 / 3
# Of meshes as scans have them, in shares of the object's largest side: a face's edge; how far they are off at most, in
# waves and by noise; how often they are smoothed; how many triangles are left of them, 0: all
FACE, WAVES, NOISE, SMOOTHED, TRIANGLES = (0.006, 0.02), 0.006, 0.001, (0, 2, 8), (0, 3000, 10000)
FLAT = ("carton", "tin", "house", "stool", "gem")  # objects of few flat faces
# which light does not leave as from a plain surface
OF_FINISHES = ("velvet", "coat", "brushed", "wax", "frosted", "dusty")
BY_EYE = {"shade": 0.15, "hue": 0.06, "roughness": 0.1}  # standard deviations: of logarithms, of the number itself


def several(plates: list[dict], seed: int) -> list[dict]:
    """The plates with two more materials each."""
    random, kinds = np.random.default_rng(seed), list(plain.FINISHES)
    out = []
    for plate in plates:
        more = []
        colours = random.choice(list(plain.COLOURS), 2)
        for colour, kind in zip(colours, random.choice(kinds, 2, p=OF_SURFACES), strict=True):
            more.append(plain.of(kind, colour))
        out.append(plate | {"more": more})
    return out


def mirroring(plates: list[dict], seed: int) -> list[dict]:
    """The plates with polished metal, every second one of a ball."""
    random, out = np.random.default_rng(seed), []
    for i, plate in enumerate(plates):
        colour, roughness = METALS[random.integers(len(METALS))], float(random.choice(POLISHED))
        surface = {"colour": colour, "roughness": roughness, "metallic": 1}
        kinds = [*plate["kinds"][:-1], f"roughness {roughness}", "an object" if i % 2 else "a ball"]
        out.append(plate | {"object": plate["object"] if i % 2 else "sphere", "surface": surface, "kinds": kinds})
    return out


def unsaid(plates: list[dict], seed: int) -> list[dict]:
    """The plates with an object and a camera that have more to them than their jobs say, which a user filled in by eye.

    ``told`` is the surface that the job has. Of an object light may come from below its skin, it may have bumps that
    its mesh has not, or be mottled; a camera may darken towards the corners, be noisy, out of focus, or have glare.
    """
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        true = plate["surface"]
        told = by_eye(true, random)
        thing = str(random.choice(OF_OBJECTS if not true["metallic"] else [k for k in OF_OBJECTS if k != "subsurface"]))
        camera, much = str(random.choice(OF_CAMERAS)), float(random.uniform())
        more = {"told": told, "thing": thing, "camera": camera, "much": much}
        out.append(plate | more | {"kinds": [*plate["kinds"], thing, camera]})
    return out


def scanned(plates: list[dict], seed: int) -> list[dict]:
    """The plates with scans: painted or mottled things, their textures with light in them; none of metal."""
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        own = plate["surface"] if not plate["surface"]["metallic"] else plain.of("satin", "clay")
        own = own | {"roughness": max(own["roughness"], MATTE)}
        others = [colour for colour in plain.COLOURS.values() if colour != own["colour"]]
        depth, other = random.uniform(*PAINT), others[random.integers(len(others))]
        paint = (1 - depth) * np.array(own["colour"]) + depth * np.array(other)
        thing, sky = str(random.choice(("painted", "mottled"))), [random.uniform(*BELOW), random.uniform(*HORIZON)]
        own_light = random.random() < OWN_LIGHT
        more = {"surface": own, "paint": paint.tolist(), "thing": thing, "much": random.uniform()}
        more["scan"] = {"sky": None if own_light else sky}
        kinds = [*plate["kinds"][:-1], thing, "scanned in the photo's light" if own_light else "under an overcast sky"]
        out.append(plate | more | {"kinds": kinds})
    return out


def remeshed(plates: list[dict], seed: int) -> list[dict]:
    """The plates with meshes as scans have them: smoother, noisy, a little off and of fewer faces."""
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        mesh = {"face": float(np.exp(random.uniform(*np.log(FACE)))), "smoothed": int(random.choice(SMOOTHED))}
        mesh |= {"waves": random.uniform(0, WAVES), "noise": random.uniform(0, NOISE)}
        mesh |= {"triangles": int(random.choice(TRIANGLES)), "seed": plate["seed"]}
        out.append(plate | {"mesh": mesh})
    return out


def by_eye(true: dict, random) -> dict:
    """A surface as a user fills it in who looks at the photo."""
    scale = np.exp(random.normal(0, BY_EYE["shade"]) + random.normal(0, BY_EYE["hue"], 3))
    return {
        "colour": tuple(np.clip(np.multiply(true["colour"], scale), 0, 1).tolist()),
        "roughness": float(np.clip(true["roughness"] + random.normal(0, BY_EYE["roughness"]), 0, 1)),
        "metallic": true["metallic"],
    }


def painted(plates: list[dict], seed: int) -> list[dict]:
    """The plates with objects that are painted in pieces, of which jobs have the mean colour, by eye; none of metal.

    Half of them stand in the dark, under one to three lamps.
    """
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        own, finish = plate["surface"], plate["kinds"][-1]
        if own["metallic"]:
            own, finish = plain.of("satin", "clay"), "satin"
        others = [colour for colour in plain.COLOURS.values() if colour != own["colour"]]
        depth, other = random.uniform(*PAINT), others[random.integers(len(others))]
        paint = (1 - depth) * np.array(own["colour"]) + depth * np.array(other)
        mean = own | {"colour": (np.array(own["colour"]) + paint) / 2}
        more = {"surface": own, "paint": paint.tolist(), "told": by_eye(mean, random), "thing": "painted"}
        usual = np.sqrt(np.pi / 4) * true_lighting(plate["light"], 0).mean()
        lamps = []
        for _ in range(random.integers(1, LAMPS + 1)):
            irradiance = random.uniform(*STRONG) * 2 * usual
            lamps.append({"direction": from_in_front(random), "irradiance": [irradiance] * 3})
        dark = random.random() < IN_THE_DARK
        if dark:
            more |= {"lamps": lamps, "dimmed": random.uniform(0, DIMMED[0]), "sun": None}
        kinds = [*plate["kinds"][:-1], finish, f"{len(lamps)} in the dark" if dark else "natural light"]
        out.append(plate | more | {"camera": "clean", "much": depth, "kinds": kinds})
    return out


def with_dust(plates: list[dict], seed: int) -> list[dict]:
    """The plates with dusty things, none of metal; of what is below, jobs have what a user sees by eye."""
    return finished([plate for plate in plates if not plate["surface"]["metallic"]], seed, ("dusty",))


def of_flat_faces(plates: list[dict]) -> list[dict]:
    """The plates with things of few flat faces (`scripts.cycles.angular`)."""
    n, out = len(FLAT), []
    for i, plate in enumerate(plates):
        name = FLAT[i % n]
        out.append(plate | {"object": name, "kinds": [*plate["kinds"], name]})
    return out


def finished(plates: list[dict], seed: int, kinds=OF_FINISHES) -> list[dict]:
    """The plates with things of a finish that jobs know nothing of, or dusty on top; the rest of it by eye."""
    random, out = np.random.default_rng(seed), []
    for i, plate in enumerate(plates):
        kind, own, finish = kinds[(i + i // len(kinds)) % len(kinds)], plate["surface"], plate["kinds"][-1]
        if (kind == "brushed") != bool(own["metallic"]) and kind not in ("coat", "dusty"):
            finish = "metal" if kind == "brushed" else "satin"
            own = plain.of(finish, random.choice(list(plain.COLOURS)))
        more = {"surface": own, "told": by_eye(own, random), "thing": kind, "camera": "clean"}
        out.append(plate | more | {"much": random.uniform(), "kinds": [*plate["kinds"][:-1], finish, kind]})
    return out
