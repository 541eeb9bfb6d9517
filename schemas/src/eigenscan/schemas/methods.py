"""Settings of several services that belong to one method, by the method's name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

Setting = str | int | float | bool
Settings = Mapping[str, Mapping[str, Setting]]
"""By service, then by field."""

METHODS: Mapping[str, Settings] = MappingProxyType(
    {
        "default": {},
        # Crowley, Wallner and Schiele (1998), section by section
        "paper": {
            "mapbuilder": {
                "spacing": 0.5,  # m, section 4
                "embedding": "range",  # section 2
                "components": 3,  # section 3: 2 or 3 are generally sufficient
            },
            "projector": {
                "association": "tetrahedra",  # 5.1, figures 5 and 7
                "margin": 0.25,  # headings are 6 degrees apart, not 0.5: sheets bend between them
                "interpolation": "ratios",  # 5.2
                "verification": "eigenspace",  # poses come from the eigenspace alone
                "obstacles": "reconstruction",  # section 6
                "published": 300,  # all volumes that enclose the scan
            },
            "tracker": {
                "method": "paper",  # section 7
                "grid_spacing": 0.5,  # m, sigma of x and y
                "grid_step": 0.1047,  # rad, sigma of heading: 6 degrees between searched headings
                "max_tracks": 300,
            },
        },
    }
)


def of_service(method: str, service: str) -> dict[str, Setting]:
    """A method's settings of a service, by field. Raises ValueError for an unknown method."""
    if method not in METHODS:
        raise ValueError(f"method {method!r}: choose one of {', '.join(METHODS)}")
    return dict(METHODS[method].get(service, {}))
