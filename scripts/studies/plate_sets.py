# SPDX-License-Identifier: GPL-3.0-or-later
"""Which plates there are: sets of everyday surfaces under everyday light, each drawn by chance from its own seed."""

import numpy as np

from scripts.cycles import plain
from scripts.cycles.lights import studio_lights, true_lighting
from scripts.studies import plate_things as things
from scripts.studies.plate_light import CORNERS, DIMMED, LAMPS, STRONG, from_in_front, of_box
from scripts.studies.plate_things import OF_SURFACES, PAINT, by_eye

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
    "angular": 226,
    "angular again": 227,
    "finished": 228,
    "finished again": 229,
    "dusty": 232,
    "neighbours": 230,
    "neighbours again": 231,
}  # seeds; what was chosen by which of them, docs/results/plates.md says
COUNT = 32
OBJECTS = ("suzanne", "blob", "knot", "vase", "pebble", "cushion")
OF_TABLES = (0.5, 0.3)  # roughness, where they are glossy
CURVES = ("srgb", "srgb", "agx", "floats")
WITH_TABLE, WITH_SUN, SUNNY = 0.6, 0.4, 0.5  # shares of the plates; of the light by the sun
SUNLIT = (0.3, 1.2)  # the same where something casts a shadow
SUN_COLOUR = np.array([1.05, 1.0, 0.9])
FILTERS = {
    "red": (1, 0.03, 0.02), "amber": (1, 0.45, 0.05), "green": (0.05, 1, 0.1), "cyan": (0.05, 0.8, 1),
    "blue": (0.03, 0.06, 1), "magenta": (1, 0.03, 0.8), "white": (1, 1, 1),
}  # fmt: skip
COVERS = ("fingers", "leaves")  # what is before a part of the object
PATTERNS, PATTERN = ("planks", "tiles", "checks", "marble", "speckles"), (0.02, 0.12)  # of tables; metres
SHADES = ("edge", "leaves")  # what keeps the sun from a part of the object
# Of softboxes: how many at most; metres from the object's middle; their edge over that; how warm or cold; the light of
# further ones over the first one's
BOXES, AWAY, EDGE, WARM, FILL = 3, (0.3, 1.2), (0.2, 0.7), 0.15, (0.2, 0.8)
ROOM = (0.03, 0.3)  # their plates' other light, times what it is
BEYOND, LARGE = (0.1, 0.45), (0.8, 1.1)  # of what the picture's edge cuts: share of its extent beyond it; of the frame
SIZE = 0.15  # metres, an object's largest side
CAMERA, CAMERA_AWAY = np.array([0.45, -1.0, 0.42]) / np.linalg.norm([0.45, -1.0, 0.42]), 0.5  # about; metres
# Of a flash on the camera: metres above the lens; its irradiance over that of the other light; that, times what it is
ABOVE_LENS, FLASHED, INDOORS = (0.03, 0.15), (0.5, 8.0), (0.05, 0.5)
# Of a paper sweep: metres behind the object's middle where it rises, radius of its bend; its colours
BEHIND, BEND = (0.15, 0.5), (0.05, 0.2)
# Of what stands beside it and no job knows: metres to a wall, and between a thing and the object's outermost; widths of
# things, their tops over the object's middle; half a wall's edge; degrees from the camera's
# azimuth, at least, of walls and of things
TO_WALL, BETWEEN, WIDE, TOP, HALF_WALL, FROM_CAMERA = (0.12, 0.5), (0.01, 0.08), (0.06, 0.2), (0.0, 0.25), 0.8, (95, 60)
PAPERS = ((0.8, 0.8, 0.79), (0.8, 0.8, 0.79), (0.4, 0.4, 0.4), (0.08, 0.08, 0.08), (0.65, 0.2, 0.2), (0.25, 0.4, 0.6))


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


def of_column(place, turn: float, halves, top: float) -> np.ndarray:
    """Upright faces and top (5, 4, 3) of a box about ``place`` (2,), from deep below; ``halves`` (2,) : half sides."""
    c, s = np.cos(turn), np.sin(turn)
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    floor = np.asarray(place) + (signs * halves) @ np.array([[c, s], [-s, c]])
    low, high = (np.column_stack([floor, np.full(4, z)]) for z in (-HALF_WALL, top))
    sides = [(low[i], low[(i + 1) % 4], high[(i + 1) % 4], high[i]) for i in range(4)]
    return np.array([*sides, tuple(high)])


def beside(plates: list[dict], seed: int) -> list[dict]:
    """The plates with a wall or a thing beside the object that no job knows."""
    random, out, colours = np.random.default_rng(seed), [], list(plain.COLOURS.values())
    camera = np.arctan2(CAMERA[1], CAMERA[0])
    for i, plate in enumerate(plates):
        kind, turn = i % 2, random.uniform()
        away = np.radians(FROM_CAMERA[kind] + turn * (360 - 2 * FROM_CAMERA[kind]))
        towards = np.array([np.cos(camera + away), np.sin(camera + away)])
        if kind:
            halves = np.exp(random.uniform(*np.log(WIDE), 2)) / 2
            distance = 0.6 * SIZE + np.linalg.norm(halves) + np.exp(random.uniform(*np.log(BETWEEN)))
            quads = of_column(distance * towards, random.uniform(0, np.pi), halves, random.uniform(*TOP))
        else:
            distance, across = np.exp(random.uniform(*np.log(TO_WALL))), np.array([-towards[1], towards[0]])
            floor = [distance * towards + sign * HALF_WALL * across for sign in (-1, 1)]
            low, high = ([(*at, z) for at in floor] for z in (-HALF_WALL, HALF_WALL))
            quads = np.array([(low[0], low[1], high[1], high[0])])
        neighbour = {"quads": quads.tolist(), "colour": colours[random.integers(len(colours))]}
        kinds = [*plate["kinds"], ("beside a wall", "beside a thing")[kind]]
        out.append(plate | {"neighbour": neighbour, "kinds": kinds})
    return out


def of_set(name: str, lights=None) -> list[dict]:
    """The plates of a set by its name; ``lights`` as of `drawn`."""
    plates, seed = drawn(SETS[name], lights), SETS[name]
    made = {
        "unsaid": things.unsaid,
        "painted": things.painted,
        "stage": on_stage,
        "shadowed": shadowed,
        "covered": covered,
        "patterned": patterned,
        "softboxes": under_boxes,
        "chrome": things.mirroring,
        "several": things.several,
        "finished": things.finished,
        "dusty": things.with_dust,
        "cut": cut,
        "flash": flashed,
        "sweep": on_paper,
        "scanned": things.scanned,
        "remeshed": things.remeshed,
        "neighbours": beside,
    }
    for kind, made_of in made.items():
        if name.startswith(kind):
            return made_of(plates, seed)
    if name.startswith("angular"):
        return things.of_flat_faces(plates)
    return on_gloss(plates) if name == "glossy tables" else plates
