"""Compiled functions that only compiled functions call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def inner(error_model: str = "python") -> Callable[[Function], Function]:
    """Numba's `njit` without an entrance for Python: so it compiles faster, and Python cannot call it."""
    decorate: Any = njit  # its types do not know these options
    compiled: Callable[[Function], Function] = decorate(
        error_model=error_model, no_cpython_wrapper=True, no_cfunc_wrapper=True
    )
    return compiled
