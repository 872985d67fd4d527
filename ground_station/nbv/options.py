"""What `--option NAME=VALUE` gives a method."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from missions.errors import UserError
from missions.nbv_trial import TrialBrief

Options = TypeVar("Options", bound=msgspec.Struct)


def options_of(brief: TrialBrief, kind: type[Options]) -> Options:
    """A trial's options as the method's own. Raises UserError for those that it does not have."""
    try:
        return msgspec.convert(brief.options, kind, strict=False)
    except msgspec.ValidationError as e:
        names = ", ".join(kind.__struct_fields__)
        raise UserError(f"--option: {e}; method {brief.method} has {names}.") from e
