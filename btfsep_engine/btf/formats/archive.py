# SPDX-License-Identifier: GPL-3.0-or-later
"""Many files of a folder or of a zip, one after the other, with limits on what a hostile zip can ask for."""

import lzma
import os
import struct
import tempfile
import zipfile
import zlib
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from btfsep_engine.errors import InputError

MAX_MEMBERS = 200_000
MAX_MEMBER_BYTES = 64 << 20
MAX_TOTAL_BYTES = 64 << 30
MAX_RATIO = 100  # images do not shrink so much; a bomb does
SMALL = 1 << 20  # bytes below which the ratio says nothing
DAMAGED = (  # all that the zipfile module lets out on damaged input
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    LookupError,
    OverflowError,
    RuntimeError,
    ValueError,
)


def no_scratch(error: OSError) -> InputError:
    """What to say where the folder for temporary files cannot be written."""
    return InputError(f"cannot write to {tempfile.gettempdir()}", error, "free space there")


@contextmanager
def scratch_folder():
    """A folder of its own, gone after the block."""
    try:
        folder = tempfile.TemporaryDirectory()
    except OSError as error:
        raise no_scratch(error) from error
    with folder as name:
        yield Path(name)


class Members:
    """The files of ``source``, a folder or a zip. Zips are never unpacked; a member becomes one scratch file.

    Raises InputError: no such folder or zip; a zip that is damaged, or that claims more than its size allows; names
    that lead out.
    """

    def __init__(self, source):
        self.source = Path(source)
        self.archive, self.infos = None, {}
        if self.source.is_dir():
            self.names = self._walk()
        else:
            self._open_zip()
            self.names = list(self.infos)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        if self.archive is not None:
            self.archive.close()

    def _fail(self, got: str, do: str = "give the zip as it was published") -> InputError:
        return InputError(str(self.source), got, do)

    def _walk(self) -> list:
        names = []
        for folder, _, files in os.walk(self.source):  # does not follow links to folders
            names += [str(Path(folder, f).relative_to(self.source)) for f in files]
            if len(names) > MAX_MEMBERS:
                raise self._fail(f"more than {MAX_MEMBERS} files are in it", "give the folder of one material")
        return sorted(names)

    def _open_zip(self) -> None:
        try:
            self.archive = zipfile.ZipFile(self.source)
        except FileNotFoundError as error:
            raise self._fail("there is no such file or folder", "check the path") from error
        except OSError as error:
            raise self._fail(error, "check the path") from error
        except DAMAGED as error:
            raise self._fail("it is neither a .btf file, nor a zip, nor a folder", "check the path") from error
        infos = self.archive.infolist()
        if len(infos) > MAX_MEMBERS:
            raise self._fail(f"{len(infos)} files are in it; {MAX_MEMBERS} are the limit")
        total, packed = sum(i.file_size for i in infos), self.source.stat().st_size
        if total > MAX_TOTAL_BYTES or (total > SMALL and total > MAX_RATIO * packed):
            raise self._fail(f"it claims to unpack from {packed} to {total} bytes, as only a zip bomb does")
        for info in infos:
            path = PurePosixPath(info.filename.replace("\\", "/"))
            if path.is_absolute() or ".." in path.parts or info.filename[1:2] == ":":
                raise self._fail(f"the name {info.filename[:80]!r} in it leads out of the folder")
            if info.filename and not info.filename.endswith("/"):
                self.infos[info.filename] = info

    @contextmanager
    def file(self, name: str):
        """The path of a file with the content of member ``name``; in a zip's case it goes away after the block."""
        if self.archive is None:
            path = self.source / name
            if not path.is_file():  # reading a pipe would wait for ever
                raise InputError(str(path), "it is gone, or no file", "check the folder")
            if path.stat().st_size > MAX_MEMBER_BYTES:
                raise InputError(str(path), f"{path.stat().st_size} bytes are more than an image has", "check the file")
            yield path
            return
        data, scratch = self._content(self.infos[name]), None
        try:
            try:
                handle, scratch = tempfile.mkstemp(suffix=PurePosixPath(name).suffix[:10])
                with os.fdopen(handle, "wb") as out:
                    out.write(data)
            except OSError as error:
                raise no_scratch(error) from error
            yield Path(scratch)
        finally:
            if scratch is not None:
                os.unlink(scratch)

    def _content(self, info) -> bytes:
        where = f"{self.source}: {info.filename[:120]}"
        if info.file_size > MAX_MEMBER_BYTES:
            raise InputError(
                where, f"it claims {info.file_size} bytes; {MAX_MEMBER_BYTES} are the limit", "check the zip"
            )
        if info.file_size > SMALL and info.file_size > MAX_RATIO * max(info.compress_size, 1):
            raise InputError(
                where, "it unpacks to more than 100 times its size, as only a zip bomb does", "check the zip"
            )
        try:
            with self.archive.open(info) as member:
                data = member.read(MAX_MEMBER_BYTES + 1)  # what it claims may be a lie
        except (*DAMAGED, OSError) as error:
            raise InputError(where, f"it cannot be unpacked ({error})", "download the zip again") from error
        if len(data) > MAX_MEMBER_BYTES:
            raise InputError(where, f"it unpacks to more than {MAX_MEMBER_BYTES} bytes", "check the zip")
        return data
