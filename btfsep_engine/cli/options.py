# SPDX-License-Identifier: GPL-3.0-or-later
"""The options that commands share. Those of a run's settings are made from the fields of `pipeline/settings.py`."""

import functools
from dataclasses import replace
from pathlib import Path

import click

from btfsep_engine.pipeline.settings import PRESETS, Meaning, Settings, choose, meanings

PATH = click.Path(path_type=Path)
JOB = click.argument("job", type=PATH)
MATERIAL = click.option("--material", help="The material of all objects, instead of the job's or of recognition.")
REPORT = click.option(
    "--report/--no-report", "with_report", default=True, show_default=True, help="Whether report.png is made."
)
LIBRARY = click.option(
    "--library",
    "library_folder",
    type=PATH,
    envvar="BTFSEP_LIBRARY",
    help="Material library.  [default: $BTFSEP_LIBRARY, else the one that comes with BTFsep]",
)
PRESET = click.option(
    "--preset",
    metavar="|".join(PRESETS),
    default="balanced",
    show_default=True,
    help="Speed against accuracy; paper: the published method.",
)
RECOGNITION = ("classifier", "verify", "seed")
ESTIMATE = ("order", "estimator", "colorspace", "robust", "sun", "key_light", "appearance", "pixels", "directions")
ESTIMATE += ("bounces", "transport", "samples", "align", "evidence", "departures", "refine", "delight")
ESTIMATE += RECOGNITION
ONE_SOLVER = ("order", "appearance", "pixels", "directions", "bounces", "seed")  # of `plan`
SEQUENCE = tuple(name for name in ESTIMATE if name not in ("estimator", "transport", "samples"))


def out_option(default: str):
    """``--out``, a folder."""
    return click.option("--out", type=PATH, help=f"Folder for the results.  [default: {default}]")


def together(*decorators):
    """Several decorators as one, the first outermost."""
    return lambda function: functools.reduce(lambda inner, outer: outer(inner), reversed(decorators), function)


def field_options(settings: dict[str, Meaning], defaults: dict):
    """An option for each of ``settings``: None where it is not given, else text (of flags: bool).

    ``defaults``: name of a preset -> settings, the usual one first.
    """
    return together(
        *(_field_option(n, m, [(p, getattr(s, n)) for p, s in defaults.items()]) for n, m in settings.items())
    )


def _field_option(name: str, meaning: Meaning, defaults):
    option = name.replace("_", "-")
    (_, usual), *others = defaults
    notes = [f"default: {_shown(usual)}"] if usual is not None else []
    notes += [f"{preset}: {_shown(value)}" for preset, value in others if value != usual]
    if meaning.kind is bool:
        return click.option(f"--{option}/--no-{option}", default=None, help=_in_words(meaning, notes))
    if meaning.many:
        return click.option(
            f"--{option}", name, metavar=meaning.unit.upper(), multiple=True, help=_in_words(meaning, notes)
        )
    notes += [] if meaning.choices else [meaning.range]
    values = [*(meaning.choices or [meaning.unit.upper()]), *["auto"] * bool(meaning.auto)]
    return click.option(f"--{option}", name, metavar="|".join(values), help=_in_words(meaning, notes))


def _shown(value) -> str:
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)


def _in_words(meaning: Meaning, notes: list[str]) -> str:
    auto = f"; auto: {meaning.auto}" if meaning.auto else ""
    return f"{meaning.help}{auto}.{'  [' + '; '.join(notes) + ']' if notes else ''}"


def takes_settings(*names: str, only_numbers=(), **prescribed):
    """Gives a command ``settings``: a preset's, with the named fields as options and what the command prescribes.

    ``only_numbers``: those of the fields that cannot be "auto" in this command.
    """
    every = meanings(Settings)
    known = {n: replace(every[n], auto="" if n in only_numbers else every[n].auto) for n in names}

    def decorate(function):
        @functools.wraps(function)
        def run(preset, **options):
            texts = {name: options.pop(name) for name in names}
            given = {n: text for n, text in texts.items() if text is not None and text != ()}
            changes = {n: known[n].checked(n, text) for n, text in given.items()}
            return function(settings=choose(preset, **changes, **prescribed), **options)

        return together(PRESET, field_options(known, {"balanced": PRESETS["balanced"], **PRESETS}))(run)

    return decorate
