# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error class whose text is meant for a person.

Anything else that is raised is a bug in BTFsep and ends a command with exit status 1.
"""


class InputError(Exception):
    """The input, or the machine, is at fault: what it is, what was found, what to do about it.

    Parameters
    ----------
    what : str
        The thing at fault, as a user would name it ("photo.exr", "object 'bunny'").
    got : str or Exception
        What was found there ("3 NaN pixels", "no such file"); of the system's error its words.
    do : str
        What to do about it ("export the image again").
    result : dict or None
        What was found out all the same, for programs.
    """

    def __init__(self, what: str, got: str | Exception, do: str, *, result: dict | None = None):
        got = getattr(got, "strerror", None) or str(got)
        self.what, self.got, self.do, self.result = what, got, do, result
        super().__init__("; ".join(part.strip().replace("\n", " ") for part in (what, got, do) if part))
