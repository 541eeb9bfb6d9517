"""What every service's settings are made of."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidatorFunctionWrapHandler, field_validator


class Settings(BaseModel):
    """Checked and immutable; unknown names are refused, and true or false where a number is meant."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @field_validator("*", mode="wrap")
    @classmethod
    def _no_truth_as_number(cls, given: Any, check: ValidatorFunctionWrapHandler) -> Any:
        taken = check(given)
        if _is_truth_as_number(given, taken):
            raise ValueError("must be a number, not true or false")
        return taken


def _is_truth_as_number(given: Any, taken: Any) -> bool:
    """Whether pydantic, for which true is 1, took it for a number, also within tables and lists."""
    if isinstance(given, dict) and isinstance(taken, dict):
        return any(_is_truth_as_number(value, taken.get(name)) for name, value in given.items())
    if isinstance(given, (list, tuple)) and isinstance(taken, (list, tuple)):
        return any(map(_is_truth_as_number, given, taken))
    return isinstance(given, bool) and isinstance(taken, (int, float)) and not isinstance(taken, bool)
