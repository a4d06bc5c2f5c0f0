# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error that becomes an operator's report. Everything else that is raised is a bug and shows its traceback."""


class InputError(Exception):
    """The scene, a file or the machine is at fault: what it is, what was found, what to do about it.

    Parameters
    ----------
    what : str, the thing at fault as a user would name it ("camera 'Camera'")
    got : str, what was found ("it is orthographic"), or the exception that says it
    do : str, what to do about it ("choose a perspective camera")
    """

    def __init__(self, what: str, got: str | Exception, do: str):
        got = getattr(got, "strerror", None) or str(got).strip().removeprefix("Error: ")
        self.what, self.got, self.do = what, got, do
        super().__init__("; ".join(part.strip().replace("\n", " ") for part in (what, got, do) if part))
