# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run can be told; stored with every result."""

from dataclasses import dataclass, replace

from btfsep_engine.errors import InputError

LARGEST_ORDER = 9
COLORSPACES = ("auto", "srgb", "linear", "unknown")
ESTIMATORS = ("map", "least-squares")
TRANSPORTS = ("kernel", "reference")
IMAGE_DIRECTIONS = 512
MODELLED_BOUNCES = 8  # where interreflections are modelled and no number was asked for


@dataclass(frozen=True)
class Settings:
    """Settings of an estimate.

    Attributes
    ----------
    preset : the name of the preset that these settings started from
    order : order of the spherical harmonics, 0 to 9, or "auto": with "map" the highest of which the photo determines
        something, with "least-squares" the lowest that cross-validation cannot tell from the best
    estimator : "map" (the most probable light of a field and lamps, all orders up to 9, ``order`` of them reported) or
        "least-squares" (the paper's: the orders up to ``order`` and no others)
    colorspace : of the photo, one of `COLORSPACES`, instead of the job's ``image_colorspace``; None: the job's
    robust : whether pixels that the light does not explain are left out (with "map"; `fit.robust.outliers`)
    key_light : "auto" (lamps of a fifth of the light or more are told apart from the sky, pipeline/lamps.py) or "never"
    appearance : "mean" (mean ABRDF, the paper's regulariser), "textured" (the BTF with the mesh's charts) or "auto"
        (mean, unless the texture lines up and explains more of the photo)
    pixels : pixels used for the fit, 0: all
    directions : light directions per pixel, or "auto": as many as no photo has shown to be too few (pipeline/basis.py)
    bounces : reflections followed; 1 is light that comes straight from outside; "auto": more than that only where it
        changes the estimate by more than its stated uncertainty (pipeline/interreflection.py)
    surface_samples : points on the scene's surfaces between which reflected light is followed
    transport : what makes the basis images: "kernel", or "reference" (the paper's path-traced image for each light)
    samples : paths per pixel and basis light (and sign) of the reference
    classifier : "svm" or "nearest"
    recogniser : "tuned" or "paper", how images are described and trained on (recognise/training.py, `METHODS`)
    verify : whether the likeliest materials are compared with the photo under the light each implies (see
        pipeline/verification.py)
    training_directions : light directions per pixel of the training images
    training_pixels : largest number of pixels of a training image
    training_turns : turns about the vertical in which each training map is used
    seed : of every random choice, 0 to 2^32 - 1
    """

    preset: str = "balanced"
    order: int | str = 4
    estimator: str = "map"
    colorspace: str | None = None
    robust: bool = False
    key_light: str = "auto"
    appearance: str = "auto"
    pixels: int = 3000
    directions: int | str = "auto"
    bounces: int | str = "auto"
    surface_samples: int = 6000
    transport: str = "kernel"
    samples: int = 256
    classifier: str = "svm"
    recogniser: str = "tuned"
    verify: bool = True
    training_directions: int = 256
    training_pixels: int = 16000
    training_turns: int = 2
    seed: int = 0

    @property
    def fit_order(self) -> int:
        """The order up to which basis images are made and fitted."""
        return LARGEST_ORDER if self.estimator == "map" or self.order == "auto" else self.order

    @property
    def many_directions(self) -> int:
        """The number of light directions for images that are looked at."""
        return IMAGE_DIRECTIONS if self.directions == "auto" else self.directions

    @property
    def reflections(self) -> int:
        """The number of reflections to follow where none is chosen by an estimate."""
        return MODELLED_BOUNCES if self.bounces == "auto" else self.bounces


PRESETS = {
    "draft": Settings("draft", pixels=2000, training_pixels=8000, training_directions=128),
    "balanced": Settings(),
    "accurate": Settings(
        "accurate",
        bounces=8,
        surface_samples=20000,
        training_directions=512,
        training_pixels=24000,
        training_turns=4,
    ),
    "paper": Settings(
        "paper",
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
    """The settings of a preset with ``changes``; None leaves a value as it is.

    Raises
    ------
    InputError
        On an unknown preset or a value out of range.
    """
    if preset not in PRESETS:
        raise InputError("--preset", f"'{preset}'", f"choose one of {', '.join(PRESETS)}")
    settings = replace(PRESETS[preset], **{k: v for k, v in changes.items() if v is not None})
    if settings.order != "auto" and not (isinstance(settings.order, int) and 0 <= settings.order <= LARGEST_ORDER):
        raise InputError("--order", str(settings.order), f"choose 0 to {LARGEST_ORDER}, or auto")
    if settings.estimator not in ESTIMATORS:
        raise InputError("--estimator", f"'{settings.estimator}'", f"choose one of {', '.join(ESTIMATORS)}")
    if settings.colorspace not in (None, *COLORSPACES):
        raise InputError("--colorspace", f"'{settings.colorspace}'", f"choose one of {', '.join(COLORSPACES)}")
    if settings.robust and settings.estimator != "map":
        raise InputError("--robust", f"with --estimator {settings.estimator}", "it goes with --estimator map only")
    if settings.key_light not in ("auto", "never"):
        raise InputError("--key-light", f"'{settings.key_light}'", "choose 'auto' or 'never'")
    if settings.transport not in TRANSPORTS:
        raise InputError("--transport", f"'{settings.transport}'", f"choose one of {', '.join(TRANSPORTS)}")
    if not 2 <= settings.samples <= 1 << 16:
        raise InputError("--samples", str(settings.samples), "choose 2 to 65536")
    if settings.appearance not in ("auto", "mean", "textured"):
        raise InputError("--appearance", f"'{settings.appearance}'", "choose 'auto', 'mean' or 'textured'")
    if settings.classifier not in ("svm", "nearest"):
        raise InputError("--classifier", f"'{settings.classifier}'", "choose 'svm' or 'nearest'")
    if not (settings.bounces == "auto" or (isinstance(settings.bounces, int) and 1 <= settings.bounces <= 64)):
        raise InputError("--bounces", str(settings.bounces), "choose 1 to 64, or auto")
    if not (
        settings.directions == "auto" or (isinstance(settings.directions, int) and 16 <= settings.directions <= 65536)
    ):
        raise InputError("--directions", str(settings.directions), "choose 16 to 65536, or auto")
    if not 0 <= settings.seed < 1 << 32:
        raise InputError("--seed", str(settings.seed), f"choose 0 to {(1 << 32) - 1}")
    if settings.pixels < 0:
        raise InputError("--pixels", str(settings.pixels), "choose a number of pixels, or 0 for all")
    return settings
