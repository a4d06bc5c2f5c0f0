# SPDX-License-Identifier: GPL-3.0-or-later
"""Which jobs a batch has: job folders that are named, found or listed, their shares, and where their results go."""

import codecs
import os
import re
from pathlib import Path

import click

from btfsep_engine.errors import InputError

RESULT = "result"  # of a job folder, where --out is not given
UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def find_jobs(places, list_file=None) -> list[Path]:
    """Job folders: those named, those in folders that are named, and those that a text file names, a line each.

    A place that is no job, and holds none, stays in the list: it fails when its turn comes, and the shares of a farm's
    tasks are the same whether it is there or not.

    Raises InputError where there is no job at all.
    """
    places = [Path(p) for p in places]
    if list_file is not None:
        places += listed(list_file)
    if not places:
        raise InputError("batch", "no jobs", "name job folders, folders of them, or --list FILE")
    found, known = {}, False
    for place in places:
        inside = jobs_in(place)
        known |= bool(inside)
        for job in inside or [place]:
            found.setdefault(os.path.abspath(job), job)  # however it is named
    if not known:
        got = "neither it nor a folder in it has a job.json"
        got += f", nor has any of {len(places) - 1} others" if len(places) > 1 else ""
        raise InputError(f"{places[0]}", got, "name job folders")
    return list(found.values())


def listed(list_file) -> list[Path]:
    """The places of a text file, a line each; "-" is standard input. Raises InputError."""
    try:
        with click.open_file(str(list_file), "rb") as file:  # names are bytes, whatever text the machine speaks
            data = file.read()
        if data.startswith(UTF16):  # Windows PowerShell's >
            data = data.decode("utf-16").encode(errors="surrogatepass")
    except (OSError, ValueError) as error:
        raise InputError(f"--list {list_file}", error, "give a text file with a job folder a line") from error
    lines = (line.strip() for line in data.removeprefix(codecs.BOM_UTF8).splitlines())
    return [Path(os.fsdecode(line)) for line in lines if line and not line.startswith(b"#")]


def jobs_in(place: Path) -> list[Path]:
    """``place`` where it is a job folder (or the job.json of one), else the job folders in it."""
    try:
        if place.name == "job.json" and place.is_file():
            return [place.parent]
        if (place / "job.json").is_file():
            return [place]
        return sorted(place / name for name in os.listdir(place) if (place / name / "job.json").is_file())
    except (OSError, ValueError):  # it is not there, is no folder, cannot be read, or is no name at all
        return []


def shard_of(jobs, shard: str | None) -> list[Path]:
    """Every n-th job of "k/n", k from 1: what the k-th of n tasks of a farm's array does."""
    if shard is None:
        return jobs
    parts = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", shard)
    k, n = map(int, parts.groups()) if parts else (0, 0)
    if not 1 <= k <= n:
        raise InputError("--shard", f"'{shard}'", "give K/N with K from 1 to N, as in 3/10")
    return jobs[k - 1 :: n]


def result_folders(jobs, out) -> list[Path]:
    """Where each job's results go: JOB/result, or OUT/<name of the job folder>.

    Raises InputError where two would go to one place; of all jobs, not of a share of them: another machine may have the
    other.
    """
    if out is None:
        return [job / RESULT for job in jobs]
    folders = [Path(out) / Path(os.path.abspath(job)).name for job in jobs]
    seen = set()
    for folder in folders:
        name = os.path.normcase(folder)
        if name in seen:
            raise InputError("--out", f"two job folders are named '{folder.name}'", "leave out --out, or rename one")
        seen.add(name)
    return folders
