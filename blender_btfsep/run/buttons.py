# SPDX-License-Identifier: GPL-3.0-or-later
"""What buttons have in common, whatever they do: a reason why they are grey, and errors said in words."""

from ..basics.errors import InputError
from . import runs


class Greyed:
    """An operator that is greyed out while ``reason(context)`` says why; the sentence is its tooltip's."""

    @staticmethod
    def reason(context) -> str:
        """As a rule, that the engine runs."""
        return runs.RUNNING if runs.is_running() else ""

    @classmethod
    def poll(cls, context):
        reason = "" if runs.adopted is not None else cls.reason(context)
        if reason:
            cls.poll_message_set(reason)
        return not reason


class AtOnce:
    """An operator that is over at once: ``do(context)`` gives a sentence for the user, or none; raises InputError."""

    def execute(self, context):
        try:
            said = self.do(context)
        except InputError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if said:
            self.report({"INFO"}, said)
        return {"FINISHED"}
