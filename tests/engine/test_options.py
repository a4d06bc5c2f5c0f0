# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the command line that are made from the settings' fields."""

import json

import click
import pytest

from btfsep_engine.cli import main, options
from btfsep_engine.cli.command import command
from btfsep_engine.cli.commands import cli
from btfsep_engine.pipeline.settings import PRESETS, choose, meanings

USUAL = choose()
COMMANDS = {name: cli.get_command(None, name) for name in cli.list_commands(None)}
TAKE_SETTINGS = {name: c for name, c in COMMANDS.items() if any(p.name == "preset" for p in c.params)}


def settings_of(arguments, capsys, *names, **how):
    """The settings that a command with options of the named fields gets, or its last line of JSON."""
    got = []

    @click.command()
    @command
    @options.takes_settings(*names, **how)
    def probe(*, settings, reporter):
        got.append(settings)
        return {}, ""

    try:
        probe.main([*arguments, "--json"], standalone_mode=False)
    except SystemExit:
        return json.loads(capsys.readouterr().out.splitlines()[-1])
    return got[0]


def test_what_is_given_goes_over_the_preset_and_what_the_command_prescribes_over_both(capsys):
    given = ["--preset", "paper", "--order", "0", "--no-robust", "--verify", "--bounces", "auto"]
    found = settings_of(given, capsys, "order", "robust", "verify", "bounces", "pixels", estimator="map")
    assert found == choose("paper", order=0, verify=True, bounces="auto", estimator="map") and found.pixels == 0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--order", "auto"], "--order; 'auto'; choose 0 to 9"),
        (["--seed", "-1"], "--seed; '-1'; choose 0 to 4294967295"),
        (["--preset", "finest"], "--preset; 'finest'; choose one of draft"),
        (["--sun", "35"], "--sun; '35'; choose ELEVATION,AZIMUTH or ELEVATION,AZIMUTH,ACCURACY in degrees"),
        (["--sun", "35,nan"], "--sun; '35,nan'"),
        (["--sun", "10,20", "--sun", "91,0"], "--sun; '91,0'"),
        (["--sun", "35,10,1,1"], "--sun; '35,10,1,1'"),
        (["--sun", "35,10", "--preset", "paper"], "--sun; with --estimator least-squares"),
        (["--robust", "--preset", "paper"], "--robust; with --estimator least-squares"),
    ],
)
def test_what_is_wrong_is_one_line_for_programs_too(capsys, given, words):
    line = settings_of(given, capsys, "order", "seed", "robust", "sun", only_numbers=("order",))
    assert line["type"] == "failed" and line["exit_code"] == 2 and words in line["message"]


def test_a_setting_that_may_be_given_again_is_all_that_was_given(capsys):
    assert settings_of(["--sun", "35,-120", "--sun", "10,20,3"], capsys, "sun").sun == ((35, -120), (10, 20, 3))
    assert settings_of([], capsys, "sun").sun is None


@pytest.mark.parametrize("name", TAKE_SETTINGS)
def test_every_default_is_shown_and_can_be_typed(name, capsys):
    assert main([name, "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    taken = {p.name: p for p in TAKE_SETTINGS[name].params if p.name in meanings(USUAL)}
    assert "seed" in taken
    for field, option in taken.items():
        usual = getattr(USUAL, field)
        shown = ("yes" if usual else "no") if option.is_flag else usual
        assert usual is None or (f"[default: {shown}" in option.help and f"[default: {shown}" in said)
        assert usual is None or meanings(USUAL)[field].checked(field, usual if option.is_flag else str(usual)) == usual
    assert all(f"{preset}: {PRESETS[preset].pixels}" in said for preset in ("draft", "paper")) or "pixels" not in taken


def test_a_batch_takes_what_an_estimate_takes_but_for_further_photos_of_one_light():
    """A shot can be tried alone and then with all; the jobs of a batch know nothing of each other."""
    alone, many = ({o for p in COMMANDS[n].params for o in p.opts} for n in ("estimate", "batch"))
    assert alone - many == {"job", "--with"}
    assert many - alone == {
        *("places", "--list", "--summary", "--lanes", "--shard", "--join", "--again", "--time-limit", "--retries"),
        "--scheduler",
        "--allow-failures",
    }
