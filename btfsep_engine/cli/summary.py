# SPDX-License-Identifier: GPL-3.0-or-later
"""What a batch says of its jobs: a journal, a line as each ends; the summary, made of it once; several made one.

Nothing here holds more of a job than its name and where its line stands, so a hundred thousand of them fit.
"""

import csv
import io
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

from btfsep_engine.errors import InputError
from btfsep_engine.storage.atomic import plain, replacing

COLUMNS = ("job", "status", "materials", "residual", "effective_degrees_of_freedom", "seconds", "warnings", "message")
STATUSES = ("done", "failed", "crashed")


class Journal:
    """A file of JSON lines that only grows, and is gone when its summary is written.

    Parameters
    ----------
    summary : the summary's path; the journal is beside it, ``batch.jsonl``
    reporter : told where it cannot be written; the batch goes on

    Attributes
    ----------
    count : status -> how many entries
    """

    def __init__(self, summary: Path, reporter):
        self.summary, self.path = summary, summary.with_suffix(".jsonl")
        self.count = dict.fromkeys(STATUSES, 0)
        self._places, self._reporter, self._file, self._end = {}, reporter, None, 0
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with suppress(OSError):  # another batch may be writing there: each has a file of its own, of one name
                self.path.unlink()
            self._file = self.path.open("w+b", buffering=0)
        except (OSError, ValueError) as error:
            self._give_up(error)

    def add(self, number: int, entry: dict) -> None:
        """What became of the job of this number."""
        self.count[entry["status"]] += 1
        if self._file is None:
            return
        line = json.dumps(plain(entry), allow_nan=False).encode() + b"\n"
        try:
            self._file.write(line)
        except OSError as error:
            self._give_up(error)
            return
        self._places[number] = self._end
        self._end += len(line)

    def close(self, **facts) -> Path | None:
        """Writes the summary, in the order of the jobs' numbers; its path, or None where it could not be written."""
        if self._file is None:
            return None
        try:
            with self._file as raw, io.BufferedReader(raw) as journal:

                def entries():
                    for number in sorted(self._places):
                        journal.seek(self._places[number])
                        yield json.loads(journal.readline())

                write_summary(self.summary, entries(), **facts)
                own = self._is_there()
            if own:
                self.path.unlink()
        except (OSError, ValueError, InputError) as error:  # the journal stays: it can be joined
            self._give_up(error)
            return None
        return self.summary

    def _is_there(self) -> bool:
        """Whether the file of the journal's name is still this one."""
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self.path.stat())
        except OSError:
            return False

    def _give_up(self, error) -> None:
        self._reporter.warn(f"no summary in {self.summary}: {error}; the results are where they belong all the same")
        if self._file is not None:
            self._file.close()
            self._file = None


def write_summary(path: Path, entries: Iterable[dict], **facts) -> None:
    """``path`` (JSON), and a table beside it (CSV), each whole or not at all. Raises InputError.

    ``facts`` : of the whole batch, beside ``jobs``
    """
    head = json.dumps({"format": "btfsep-batch", "version": 1, **facts})
    with ExitStack() as files:
        table_path = files.enter_context(replacing(Path(path).with_suffix(".csv")))
        json_path = files.enter_context(replacing(path))
        text = files.enter_context(json_path.open("w", encoding="ascii", newline="\n"))
        rows = files.enter_context(table_path.open("w", encoding="utf-8", errors="backslashreplace", newline=""))
        table = csv.DictWriter(rows, COLUMNS, extrasaction="ignore")
        table.writeheader()
        text.write(head[:-1] + ', "jobs": [')
        for i, entry in enumerate(entries):
            text.write((",\n " if i else "\n ") + json.dumps(plain(entry), allow_nan=False))
            lists = (entry.get(name) for name in ("materials", "warnings"))
            materials, warnings = (each if isinstance(each, list) else [] for each in lists)  # of any program's summary
            table.writerow({**entry, "materials": " ".join(map(str, materials)), "warnings": len(warnings)})
        text.write("\n]}\n")


def read_entries(path: Path) -> tuple[dict, Iterator[dict]]:
    """The facts of a summary, or of the journal of a batch that was stopped, and its entries.

    Raises InputError when it is neither.
    """
    do = "give batch.json files, or the .jsonl of stopped ones"
    wrong = InputError(f"{path}", "it is no summary of a batch", do)
    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(f"{path}", error, do) from error
    try:
        tree = json.loads(data)
        if not isinstance(tree, dict) or tree.get("format") != "btfsep-batch":
            raise ValueError
        facts, entries = {k: v for k, v in tree.items() if k not in ("format", "version", "jobs")}, tree.get("jobs")
    except (ValueError, RecursionError):
        facts, entries = {}, []
        for line in io.BytesIO(data):
            with suppress(ValueError, RecursionError):  # the last line of one that was killed
                entries.append(json.loads(line))
        if not entries and data.strip():
            raise wrong from None
    if not isinstance(entries, list) or not all(_is_entry(e) for e in entries):
        raise wrong
    return facts, iter(entries)


def _is_entry(entry) -> bool:
    return isinstance(entry, dict) and isinstance(entry.get("job"), str) and entry.get("status") in STATUSES


def summaries_in(path: Path) -> list[Path]:
    """Itself; of a folder, those of shards. InputError where it has none."""
    if not path.is_dir():
        return [path]
    found = sorted(path.glob("batch-*-of-*.json"))
    if not found:
        raise InputError(
            f"{path}", "there is no batch-K-of-N.json in it", "name summaries, or a folder of those of shards"
        )
    return found


def join(paths, summary: Path, reporter) -> dict:
    """One summary of several, or of folders of them: each job once, done where one has it so, else as the last says.

    Gives a dict: how many are "done", "failed", "crashed", and the "summary". Raises InputError.
    """
    jobs, shards = {}, {}
    for one in (one for path in paths for one in summaries_in(path)):
        facts, entries = read_entries(one)
        shard = str(facts.get("shard") or "")
        if shard.count("/") == 1:
            k, n = shard.split("/")
            shards.setdefault(n, set()).add(k)
        for entry in entries:
            if jobs.get(entry["job"], entry)["status"] != "done" or entry["status"] == "done":
                jobs[entry["job"]] = entry
    for n, there in shards.items():
        missing = [str(k) for k in range(1, 1 + int(n)) if str(k) not in there] if n.isdecimal() else []
        if missing:
            reporter.warn(f"of {n} shards there is no summary of {', '.join(missing[:10])}")
    write_summary(summary, jobs.values())
    count = {status: sum(e["status"] == status for e in jobs.values()) for status in STATUSES}
    return {**count, "summary": str(summary)}
