# SPDX-License-Identifier: GPL-3.0-or-later
"""Which plates there are: sets of everyday surfaces under everyday light, each drawn by chance from its own seed."""

import numpy as np

from scripts.cycles import plain
from scripts.cycles.lights import studio_lights, true_lighting
from scripts.studies.plate_light import CORNERS, of_box

SETS = {
    "first": 1,
    "second": 2,
    "third": 3,
    "several": 4,
    "chrome": 5,
    "fourth": 6,
    "fifth": 7,
    "sixth": 8,
    "seventh": 9,
    "glossy tables": 9,  # those of the seventh that have one
    "stage": 10,
    "eighth": 11,
    "ninth": 12,
    "unsaid": 13,
    "unsaid again": 14,
    "painted": 15,
    "painted again": 16,
    "tenth": 201,
    "unsaid anew": 202,
    "stage anew": 203,
    "painted anew": 204,
    "shadowed": 205,
    "shadowed again": 206,
    "covered": 207,
    "covered again": 208,
    "patterned": 209,
    "patterned again": 210,
    "softboxes": 211,
    "softboxes again": 212,
    "chrome again": 213,
    "chrome anew": 214,
    "cut": 215,
    "cut again": 216,
    "flash": 217,
    "flash again": 218,
    "sweep": 219,
    "sweep again": 220,
    "scanned": 221,
    "scanned again": 222,
    "remeshed": 223,
    "remeshed again": 224,
    "shadowed anew": 225,
}  # seeds; what was chosen by which of them, docs/results/plates.md says
COUNT = 32
OBJECTS = ("suzanne", "blob", "knot", "vase", "pebble", "cushion")
OF_SURFACES = (0.35, 0.3, 0.25, 0.1)
METALS = (
    (0.55, 0.556, 0.554),
    (0.97, 0.96, 0.91),
    (1.0, 0.77, 0.34),
    (0.95, 0.64, 0.54),
)  # chrome, silver, gold, copper
POLISHED = (0.0, 0.1, 0.2)  # roughness
OF_TABLES = (0.5, 0.3)  # roughness, where they are glossy
CURVES = ("srgb", "srgb", "agx", "floats")
WITH_TABLE, WITH_SUN, SUNNY = 0.6, 0.4, 0.5  # shares of the plates; of the light by the sun
SUNLIT = (0.3, 1.2)  # the same where something casts a shadow
SUN_COLOUR = np.array([1.05, 1.0, 0.9])
FILTERS = {
    "red": (1, 0.03, 0.02), "amber": (1, 0.45, 0.05), "green": (0.05, 1, 0.1), "cyan": (0.05, 0.8, 1),
    "blue": (0.03, 0.06, 1), "magenta": (1, 0.03, 0.8), "white": (1, 1, 1),
}  # fmt: skip
LAMPS, DIMMED, STRONG = 3, (0.03, 0.15), (1.0, 2.0)  # of a stage: at most; its other light, times what it is; lamps'
# irradiance, times what that of the other light would be undimmed
OF_OBJECTS = ("as said", "subsurface", "bumps", "mottled")
OF_CAMERAS = ("clean", "vignette", "grain", "soft", "glare")
PAINT, IN_THE_DARK = (0.3, 0.8), 0.5  # how much of a piece's colour is the paint's; share of plates with lamps alone
COVERS = ("fingers", "leaves")  # what is before a part of the object
PATTERNS, PATTERN = ("planks", "tiles", "checks", "marble", "speckles"), (0.02, 0.12)  # of tables; metres
SHADES = ("edge", "leaves")  # what keeps the sun from a part of the object
# Of softboxes: how many at most; metres from the object's middle; their edge over that; how warm or cold; the light of
# further ones over the first one's
BOXES, AWAY, EDGE, WARM, FILL = 3, (0.3, 1.2), (0.2, 0.7), 0.15, (0.2, 0.8)
ROOM = (0.03, 0.3)  # their plates' other light, times what it is
BEYOND, LARGE = (0.1, 0.45), (0.8, 1.1)  # of what the picture's edge cuts: share of its extent beyond it; of the frame
CAMERA, CAMERA_AWAY = np.array([0.45, -1.0, 0.42]) / np.linalg.norm([0.45, -1.0, 0.42]), 0.5  # about; metres
# Of a flash on the camera: metres above the lens; its irradiance over that of the other light; that, times what it is
ABOVE_LENS, FLASHED, INDOORS = (0.03, 0.15), (0.5, 8.0), (0.05, 0.5)
# Of a paper sweep: metres behind the object's middle where it rises, radius of its bend; its colours
BEHIND, BEND = (0.15, 0.5), (0.05, 0.2)
PAPERS = ((0.8, 0.8, 0.79), (0.8, 0.8, 0.79), (0.4, 0.4, 0.4), (0.08, 0.08, 0.08), (0.65, 0.2, 0.2), (0.25, 0.4, 0.6))
# Of scans: least roughness; their sky's radiances below and at the horizon over that above; share in the photo's light
MATTE, BELOW, HORIZON, OWN_LIGHT = 0.5, (0.1, 0.5), (0.4, 1.0), 1 / 3
# Of meshes as scans have them, in shares of the object's largest side: a face's edge; how far they are off at most, in
# waves and by noise; how often they are smoothed; how many triangles are left of them, 0: all
FACE, WAVES, NOISE, SMOOTHED, TRIANGLES = (0.006, 0.02), 0.006, 0.001, (0, 2, 8), (0, 3000, 10000)
BY_EYE = {"shade": 0.15, "hue": 0.06, "roughness": 0.1}  # standard deviations: of logarithms, of the number itself


def drawn(seed: int, lights=None) -> list[dict]:
    """The plates of a set, as `scripts.cycles.plates` takes them; ``kinds`` in words.

    ``lights`` : names of Blender's studio lights, or paths of maps; None: all of Blender's
    """
    random, out = np.random.default_rng(seed), []
    lights, colours = sorted(lights or studio_lights()), list(plain.COLOURS)
    for i in range(COUNT):
        kind = random.choice(list(plain.FINISHES), p=OF_SURFACES)
        colour, light, top = random.choice(colours), str(random.choice(lights)), random.choice(colours)
        turn, off, way = random.uniform(0, 360), int(random.integers(3)), random.uniform(0, 2 * np.pi)
        azimuth, height, table = random.uniform(0, 2 * np.pi), random.uniform(0.35, 1.2), random.random() < WITH_TABLE
        sunny, curve = random.random() < WITH_SUN, str(random.choice(CURVES))
        towards = [np.cos(azimuth) * np.cos(height), -abs(np.sin(azimuth)) * np.cos(height), np.sin(height)]
        strength = SUNNY * np.sqrt(4 * np.pi) * true_lighting(light, 0).mean()
        out.append(
            {
                "name": f"{i:02d}",
                "object": OBJECTS[i % len(OBJECTS)],
                "seed": 11 + i,
                "surface": plain.of(kind, colour),
                "light": light,
                "turn": turn,
                "sun": {"direction": towards, "irradiance": list(strength * SUN_COLOUR)} if sunny else None,
                "table": plain.COLOURS[top] if table else None,
                "curve": curve,
                "off": [off * np.cos(way), off * np.sin(way)],
                "kinds": [f"{off} px off", curve, "on a table" if table else "alone", str(kind)],
            }
        )
    return out


def several(plates: list[dict]) -> list[dict]:
    """The plates with two more materials each."""
    random, kinds = np.random.default_rng(SETS["several"]), list(plain.FINISHES)
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


def on_gloss(plates: list[dict]) -> list[dict]:
    """The plates that have a table, on one that is glossy."""
    plates, n = [plate for plate in plates if plate["table"]], len(OF_TABLES)
    return [plate | {"table_roughness": OF_TABLES[i % n]} for i, plate in enumerate(plates)]


def on_stage(plates: list[dict], seed: int) -> list[dict]:
    """The plates under lamps with filters in place of the sun, and dim light."""
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        count, usual = int(random.integers(1, LAMPS + 1)), np.sqrt(np.pi / 4) * true_lighting(plate["light"], 0).mean()
        lamps = []
        for colour in random.choice(list(FILTERS), count, replace=False):
            towards, strength = from_in_front(random), random.uniform(*STRONG)
            irradiance = strength * usual * 2 * np.array(FILTERS[colour])
            lamps.append({"direction": towards, "irradiance": irradiance.tolist()})
        kinds = [*plate["kinds"], f"{count} lamp{'s' if count > 1 else ''}"]
        more = {"lamps": lamps, "dimmed": random.uniform(*DIMMED), "sun": None, "kinds": kinds}
        out.append(plate | more)
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


def shadowed(plates: list[dict], seed: int) -> list[dict]:
    """The plates in the sun, of which something that no job knows keeps the sun from a part of the object."""
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        towards, kind = from_in_front(random), str(random.choice(SHADES))
        strength = random.uniform(*SUNLIT) * np.sqrt(4 * np.pi) * true_lighting(plate["light"], 0).mean()
        shade = {"kind": kind, "turn": random.uniform(0, 2 * np.pi), "much": random.uniform(), "seed": plate["seed"]}
        sun = {"direction": towards, "irradiance": list(strength * SUN_COLOUR)}
        out.append(plate | {"sun": sun, "shade": shade, "kinds": [*plate["kinds"], kind]})
    return out


def covered(plates: list[dict], seed: int) -> list[dict]:
    """The plates with something before a part of the object that no job knows."""
    random, out, colours = np.random.default_rng(seed), [], list(plain.COLOURS.values())
    for plate in plates:
        kind, colour = str(random.choice(COVERS)), colours[random.integers(len(colours))]
        cover = {"kind": kind, "turn": random.uniform(0, 2 * np.pi), "much": random.uniform(), "seed": plate["seed"]}
        out.append(plate | {"cover": cover | {"colour": colour}, "kinds": [*plate["kinds"], kind]})
    return out


def patterned(plates: list[dict], seed: int) -> list[dict]:
    """The plates on tables of two colours in a pattern, of which jobs have the mean, by eye."""
    random, out, colours = np.random.default_rng(seed), [], list(plain.COLOURS.values())
    for i, plate in enumerate(plates):
        own = plate["table"] or colours[random.integers(len(colours))]
        depth, kind = random.uniform(*PAINT), PATTERNS[i % len(PATTERNS)]
        others = [colour for colour in colours if colour != own]
        other = (1 - depth) * np.array(own) + depth * np.array(others[random.integers(len(others))])
        mean = {"colour": own if kind == "tiles" else (np.array(own) + other) / 2, "roughness": 1, "metallic": 0}
        size, turn = float(np.exp(random.uniform(*np.log(PATTERN)))), random.uniform(0, 2 * np.pi)
        pattern = {"kind": kind, "other": other.tolist(), "size": size, "turn": turn}
        pattern["told"] = by_eye(mean, random)["colour"]
        kinds = [*(kind for kind in plate["kinds"] if kind not in ("alone", "on a table")), kind]
        out.append(plate | {"table": own, "pattern": pattern, "kinds": kinds})
    return out


def under_boxes(plates: list[dict], seed: int) -> list[dict]:
    """The plates under one to three softboxes that stand near, in place of the sun, and dim light."""
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        count, usual = int(random.integers(1, BOXES + 1)), np.sqrt(np.pi / 4) * true_lighting(plate["light"], 0).mean()
        boxes = []
        for i in range(count):
            azimuth, height = random.uniform(0, 2 * np.pi), random.uniform(0.4, 1.2)
            to_camera = abs(np.sin(azimuth)) if i < 2 else np.sin(azimuth)
            towards = [np.cos(azimuth) * np.cos(height), -to_camera * np.cos(height), np.sin(height)]
            distance, edge = float(np.exp(random.uniform(*np.log(AWAY)))), float(random.uniform(*EDGE))
            irradiance = random.uniform(*STRONG) * 2 * usual * (random.uniform(*FILL) if i else 1)
            colour = 1 + random.uniform(-WARM, WARM) * np.array([1, 0, -1])
            radiance = (irradiance / edge**2 * colour).tolist()
            box = {"direction": towards, "distance": distance, "edge": edge * distance, "radiance": radiance}
            boxes.append(box | {"corners": of_box(box, CORNERS).tolist()})
        kinds = [*plate["kinds"], f"{count} softbox{'es' if count > 1 else ''}"]
        out.append(plate | {"boxes": boxes, "dimmed": random.uniform(*ROOM), "sun": None, "kinds": kinds})
    return out


def cut(plates: list[dict], seed: int) -> list[dict]:
    """The plates so near that an edge of the picture cuts the object."""
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        way = str(random.choice(("left", "right", "up", "down")))
        beyond, fill = float(random.uniform(*BEYOND)), float(random.uniform(*LARGE))
        out.append(plate | {"cut": {"way": way, "beyond": beyond, "fill": fill}, "kinds": [*plate["kinds"], way]})
    return out


def flashed(plates: list[dict], seed: int) -> list[dict]:
    """The plates indoors, with a flash on the camera in place of the sun."""
    random, out = np.random.default_rng(seed), []
    for plate in plates:
        dimmed, strength = random.uniform(*INDOORS), float(np.exp(random.uniform(*np.log(FLASHED))))
        usual = np.sqrt(np.pi / 4) * true_lighting(plate["light"], 0).mean() * 2 * dimmed
        above = random.uniform(*ABOVE_LENS) * np.cross(CAMERA, np.cross((0, 0, 1), CAMERA)) / np.linalg.norm(CAMERA[:2])
        flash = {"place": (CAMERA_AWAY * CAMERA + above).tolist(), "irradiance": [float(strength * usual)] * 3}
        kinds = [*plate["kinds"], f"flash {'above' if strength > 2 else 'below'} twice the room"]
        out.append(plate | {"flash": flash, "dimmed": dimmed, "sun": None, "kinds": kinds})
    return out


def on_paper(plates: list[dict], seed: int) -> list[dict]:
    """`under_boxes` on a sweep of paper: a floor that rises behind the object."""
    random, out = np.random.default_rng(seed), []
    for plate in under_boxes(plates, seed):
        colour = PAPERS[random.integers(len(PAPERS))]
        sweep = {"behind": float(random.uniform(*BEHIND)), "bend": float(random.uniform(*BEND))}
        kinds = [kind for kind in plate["kinds"] if kind not in ("alone", "on a table")]
        kinds.append("white paper" if min(colour) > 0.7 else "other paper")
        out.append(plate | {"table": colour, "sweep": sweep, "kinds": kinds})
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


def from_in_front(random) -> list[float]:
    """A random direction (3,) above the ground, on the camera's side."""
    azimuth, height = random.uniform(0, 2 * np.pi), random.uniform(0.1, 1.2)
    return [np.cos(azimuth) * np.cos(height), -abs(np.sin(azimuth)) * np.cos(height), np.sin(height)]


def of_set(name: str, lights=None) -> list[dict]:
    """The plates of a set by its name; ``lights`` as of `drawn`."""
    plates, seed = drawn(SETS[name], lights), SETS[name]
    made = {
        "unsaid": unsaid,
        "painted": painted,
        "stage": on_stage,
        "shadowed": shadowed,
        "covered": covered,
        "patterned": patterned,
        "softboxes": under_boxes,
        "chrome": mirroring,
        "cut": cut,
        "flash": flashed,
        "sweep": on_paper,
        "scanned": scanned,
        "remeshed": remeshed,
    }
    for kind, made_of in made.items():
        if name.startswith(kind):
            return made_of(plates, seed)
    return {"several": several, "glossy tables": on_gloss}.get(name, list)(plates)
