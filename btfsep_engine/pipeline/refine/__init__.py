# SPDX-License-Identifier: GPL-3.0-or-later
"""What the model of a scene may need beside its simplest form, each looked at once a light is known.

A refinement is a function (Model, SolvedLight) -> (Model, SolvedLight, {what: why}): it hands both on as they are, or
nearer to the photo, and says in words for ``result.json`` what it chose, if it had to.
"""


def refined(model, light, choice: dict, refinements):
    """A model and its light, refined in turn; and ``choice`` with what was chosen on the way."""
    for refinement in refinements:
        model, light, words = refinement(model, light)
        choice = choice | words
    return model, light, choice
