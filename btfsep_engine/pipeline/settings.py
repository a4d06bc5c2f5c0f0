# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run can be told, stage by stage; stored with every result.

A setting is one field: its default, and in its metadata what it means and takes. The checks, the options of the command
line and their help (`cli/options.py`) are made from that. A function takes the settings of its stage; :class:`Settings`
is all of them, so that it can be handed to any.
"""

from dataclasses import dataclass, field, fields, replace

from btfsep_engine.errors import InputError

LARGEST_ORDER = 9
IMAGE_DIRECTIONS = 512
MODELLED_BOUNCES = 8  # where interreflections are modelled and no number was asked for
_VIEWS = ("agx", "agx-punchy", "agx-medium-high-contrast", "agx-high-contrast", "filmic", "khronos")
CURVES = ("auto", "srgb", "camera", "phone", "linear", "blender", *_VIEWS, "unknown")

APPEARANCE = (
    "The mean ABRDF, as in the paper, or the textured BTF; auto: the texture where it lines up and explains more"
)
DIRECTIONS = "as many as no photo has shown to be too few"
BOUNCES = "Reflections followed, 1: no light between surfaces"
MORE_BOUNCES = "more where that changes an estimate by more than its stated uncertainty; without an estimate 8"
BASIS_IMAGES = "What makes the basis images; reference: the paper's path-traced image for each basis light"
BEST_ORDER = "the highest of which the photo determines something; with least-squares by cross-validation"
DEPARTURES = "Rougher and glossier materials than an object's are tried where the photo asks for them"
REFINE = (
    "What the photo may ask for beside the simplest model is looked at: all of it, or (quick) not what takes long and "
    "seldom moves the light: a ground under the objects, a flash, lamps sharper than the harmonics, lamps nearby, "
    "things in front, shadows of what no job knows, haze; or (least) light between surfaces alone"
)
ESTIMATOR = "The most probable light of a field and lamps, all orders, or the paper's fit of orders up to --order"
ALIGN = (
    "Whether a camera that is off is moved into line for this estimate: where outlines and shading ask for it (auto), "
    "only where the outline lies beside the object's (outline), or never"
)
SUN = (
    "A lamp far away whose direction is known: degrees above horizon, degrees from +X towards +Y, and how well, if not "
    "to 1 degree; instead of the job's; may be given again"
)
EVIDENCE = (
    "Which occluders' own pixels tell of the light, too: those that the job names, and else plain ones where the light "
    "explains all that they show (auto; not in a draft); those that it names alone (job); all; or none (never). With "
    "auto and all, a ground that the photo shows under objects beside which the job has nothing is taken to be there"
)
DELIGHT = "Whether light that is found in an object's texture, as scans have it, is taken off it"
LAMPS = "Whether lamps of a fifth of the light or more are told apart from the sky"


class Angles(tuple):
    """Degrees of elevation, azimuth and, where it is said, accuracy, of their text with commas or of numbers."""

    def __new__(cls, value):
        numbers = [float(part) for part in (value.split(",") if isinstance(value, str) else value)]
        elevation, azimuth, accuracy = (*numbers, 0.0) if len(numbers) == 2 else numbers  # or ValueError
        if not (abs(elevation) <= 90 and abs(azimuth) <= 360 and 0 <= accuracy <= 45):
            raise ValueError("out of range")
        return super().__new__(cls, numbers)


@dataclass(frozen=True)
class Meaning:
    """What a setting means and takes.

    Attributes
    ----------
    help : for people, a sentence without its end
    kind : type of its values
    choices : the only values, where there are few
    low, high : ends of its range; None: open
    auto : what "auto" means, where it may be that
    unit : what is counted
    many : whether it is a tuple of such values
    """

    help: str
    kind: type
    choices: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None
    auto: str = ""
    unit: str = "n"
    many: bool = False

    @property
    def range(self) -> str:
        """What it takes, in words."""
        if self.kind is bool:
            return "true or false"
        if self.kind is Angles:
            return "ELEVATION,AZIMUTH or ELEVATION,AZIMUTH,ACCURACY in degrees, as in 35,-120"
        ends = f"{self.low} or more" if self.high is None else f"{self.low} to {self.high}"
        return (f"one of {', '.join(self.choices)}" if self.choices else ends) + ", or auto" * bool(self.auto)

    def checked(self, name: str, value):
        """``value``, or what its text on a command line says; ``name`` is the field's. Raises InputError."""
        if self.many:
            return tuple(replace(self, many=False).checked(name, each) for each in value)
        if self.auto and isinstance(value, str) and value == "auto":
            return value
        try:
            number = self.kind(value)
            same = isinstance(value, bool) == (self.kind is bool) and (isinstance(value, str) or number == value)
        except (TypeError, ValueError, OverflowError):
            same = False
        if not same or (self.choices and number not in self.choices) or not self._within(number):
            raise InputError(f"--{name.replace('_', '-')}", f"'{value}'", f"choose {self.range}")
        return number

    def _within(self, number) -> bool:
        return (self.low is None or number >= self.low) and (self.high is None or number <= self.high)


def setting(default, help: str, *, kind: type | None = None, **meaning):
    """A field of a dataclass of settings; ``meaning`` as of :class:`Meaning`, ``kind`` by default the default's."""
    kind = kind or (str if meaning.get("choices") else type(default))
    return field(default=default, metadata={"meaning": Meaning(help, kind, **meaning)})


def meanings(settings) -> dict[str, Meaning]:
    """Name of the field -> what it means, of a dataclass of settings or one of its class."""
    return {f.name: f.metadata["meaning"] for f in fields(settings) if "meaning" in f.metadata}


def changed(settings, **changes):
    """``settings`` with ``changes``, as numbers or as a command line's texts; None leaves a value as it is.

    Raises
    ------
    InputError
        On a value out of its range, with the option's name.
    """
    known = meanings(settings)
    return replace(settings, **{k: known[k].checked(k, v) for k, v in changes.items() if v is not None})


@dataclass(frozen=True)
class Seeded:
    """What every stage with random choices is told."""

    seed: int = setting(0, "Seed of every random choice", low=0, high=(1 << 32) - 1)


@dataclass(frozen=True)
class RecognitionSettings(Seeded):
    """How materials are recognised (recognise/training.py, pipeline/recognition.py)."""

    classifier: str = setting("svm", "What tells the materials apart", choices=("svm", "nearest"))
    recogniser: str = setting("tuned", "How images are described and trained on", choices=("tuned", "paper"))
    verify: bool = setting(True, "Compare the likeliest materials with the photo under the light each implies")
    training_directions: int = setting(256, "Light directions per pixel of the training images", low=16, high=65536)
    training_pixels: int = setting(16000, "Largest number of pixels of a training image", low=1)
    training_turns: int = setting(2, "Turns about the vertical in which each training map is used", low=1)


@dataclass(frozen=True)
class PhotoSettings(Seeded):
    """What is taken of the photo."""

    colorspace: str | None = setting(None, "The photo's curve instead of the job's; unknown: found", choices=CURVES)
    align: str = setting("auto", ALIGN, choices=("auto", "outline", "never"))
    evidence: str = setting("auto", EVIDENCE, choices=("auto", "job", "all", "never"))
    pixels: int = setting(3000, "Pixels used for the fit, 0: all", low=0, unit="pixels")


@dataclass(frozen=True)
class TransportSettings(Seeded):
    """How light's way from outside to the camera is followed (render/transport.py, pipeline/basis.py)."""

    appearance: str = setting("auto", APPEARANCE, choices=("auto", "mean", "textured"))
    directions: int | str = setting(
        "auto", "Light directions per pixel", kind=int, low=16, high=65536, auto=DIRECTIONS, unit="directions"
    )
    bounces: int | str = setting("auto", BOUNCES, kind=int, low=1, high=64, auto=MORE_BOUNCES, unit="bounces")
    surface_samples: int = setting(3000, "Points on surfaces between which reflected light is followed", low=1)
    transport: str = setting("kernel", BASIS_IMAGES, choices=("kernel", "reference"))
    delight: str = setting("auto", DELIGHT, choices=("auto", "never"))
    samples: int = setting(256, "Paths per pixel and basis light of the reference", low=2, high=1 << 16, unit="paths")

    @property
    def many_directions(self) -> int:
        """The number of light directions for images that are looked at."""
        return IMAGE_DIRECTIONS if self.directions == "auto" else self.directions

    @property
    def reflections(self) -> int:
        """The number of reflections to follow where none is chosen by an estimate."""
        return MODELLED_BOUNCES if self.bounces == "auto" else self.bounces


@dataclass(frozen=True)
class FitSettings(Seeded):
    """How the light is fitted and what of it is reported (fit/, pipeline/together.py)."""

    order: int | str = setting(4, "Order of the spherical harmonics", low=0, high=LARGEST_ORDER, auto=BEST_ORDER)
    estimator: str = setting("map", ESTIMATOR, choices=("map", "least-squares"))
    robust: bool = setting(False, "Leave out pixels that the light does not explain: things in front")
    sun: tuple | None = setting(None, SUN, kind=Angles, many=True, unit="elevation,azimuth[,accuracy]")
    key_light: str = setting("auto", LAMPS, choices=("auto", "never"))
    departures: str = setting("auto", DEPARTURES, choices=("auto", "never"))
    refine: str = setting("all", REFINE, choices=("all", "quick", "least"))

    @property
    def fit_order(self) -> int:
        """The order up to which basis images are made and fitted."""
        return LARGEST_ORDER if self.estimator == "map" or self.order == "auto" else self.order


@dataclass(frozen=True)
class Settings(FitSettings, TransportSettings, PhotoSettings, RecognitionSettings):
    """All of an estimate's. ``preset`` is the name of the preset that they started from."""

    preset: str = "balanced"


PRESETS = {
    "draft": Settings(
        preset="draft", pixels=2000, align="outline", refine="quick", training_pixels=8000, training_directions=128
    ),
    "balanced": Settings(),
    "accurate": Settings(
        preset="accurate",
        bounces=MODELLED_BOUNCES,
        surface_samples=20000,
        training_directions=512,
        training_pixels=24000,
        training_turns=4,
    ),
    "paper": Settings(
        preset="paper",
        estimator="least-squares",
        appearance="mean",
        pixels=0,
        directions=1024,
        bounces=MODELLED_BOUNCES,
        recogniser="paper",
        verify=False,
    ),
}


def choose(preset: str = "balanced", **changes) -> Settings:
    """The settings of a preset with ``changes``, as of :func:`changed`.

    Raises
    ------
    InputError
        On an unknown preset, a value out of its range, or values that do not go together.
    """
    if preset not in PRESETS:
        raise InputError("--preset", f"'{preset}'", f"choose one of {', '.join(PRESETS)}")
    settings = changed(PRESETS[preset], **changes)
    if settings.robust and settings.estimator != "map":
        raise InputError("--robust", f"with --estimator {settings.estimator}", "it goes with --estimator map only")
    if settings.sun and settings.estimator != "map":
        raise InputError("--sun", f"with --estimator {settings.estimator}", "it goes with --estimator map only")
    return settings
