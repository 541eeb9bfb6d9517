"""State and factsheet, by the tables of fields of the standard's versions 2.1.0 and 3.0.0."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from eigenscan.vda5050.actions import FACTSHEET_REQUEST, SET_POSITION, STATE_REQUEST, Actions
from eigenscan.vda5050.settings import Vda5050Settings

LOCALIZATION_ERROR = "LOCALIZATION_ERROR"
UNKNOWN = "battery, loads, safety, orders: not known to the localizer"
"""Those fields hold constants, because the standard requires them."""


@dataclass
class Situation:
    """The content of a state."""

    position: dict[str, Any] | None = None
    driving: bool = False
    last_node: str = ""
    actions: Actions = field(default_factory=Actions)
    errors: list[dict[str, Any]] = field(default_factory=list)
    maps: list[str] = field(default_factory=list)
    map_version: str = ""


def error(kind: str, level: str, words: str, **references: str) -> dict[str, Any]:
    """One error of a state."""
    fields: dict[str, Any] = {"errorType": kind, "errorLevel": level, "errorDescription": words}
    if references:
        fields["errorReferences"] = [
            {"referenceKey": key, "referenceValue": value} for key, value in references.items()
        ]
    return fields


def state(now: Situation, settings: Vda5050Settings) -> dict[str, Any]:
    """The topic state."""
    second = settings.major == 2
    fields: dict[str, Any] = {
        "maps": [
            {"mapId": name, "mapVersion": now.map_version or "unknown", "mapStatus": "ENABLED"}
            for name in now.maps
        ],
        "orderId": "",
        "orderUpdateId": 0,
        "lastNodeId": now.last_node,
        "lastNodeSequenceId": 0,
        "nodeStates": [],
        "edgeStates": [],
        "driving": now.driving,
        "operatingMode": settings.operating_mode,
        "errors": now.errors,
        "information": [
            {
                "infoType": "LOCALIZER_ONLY",
                "infoDescription" if second else "infoDescriptor": UNKNOWN,
                "infoLevel": "INFO",
            }
        ],
    }
    listed = now.actions.state_fields(settings.major)
    if second:
        fields["actionStates"] = listed
        fields["batteryState"] = {"batteryCharge": 0.0, "charging": False}
        fields["safetyState"] = {"eStop": "NONE", "fieldViolation": False}
    else:
        fields["actionStates"], fields["instantActionStates"] = [], listed
        fields["powerSupply"] = {"stateOfCharge": 0.0, "charging": False}
        fields["safetyState"] = {"activeEmergencyStop": "NONE", "fieldViolation": False}
    if now.position is not None:
        fields[position_field(settings)] = now.position
    return fields


def position_field(settings: Vda5050Settings) -> str:
    """The name of the position."""
    return "agvPosition" if settings.major == 2 else "mobileRobotPosition"


def factsheet(settings: Vda5050Settings) -> dict[str, Any]:
    """The topic factsheet: the bridge's abilities; sizes and loads come from the settings."""
    fields = _factsheet_2() if settings.major == 2 else _factsheet_3()
    for name, given in settings.factsheet.items():
        own = fields.get(name)
        fields[name] = own | given if isinstance(own, dict) and isinstance(given, dict) else given
    return fields


def _parameters() -> list[dict[str, Any]]:
    kinds = {"x": "NUMBER", "y": "NUMBER", "theta": "NUMBER", "mapId": "STRING", "lastNodeId": "STRING"}
    return [
        {"key": key, "valueDataType": kind, "isOptional": key == "lastNodeId"} for key, kind in kinds.items()
    ]


def _factsheet_2() -> dict[str, Any]:
    kinds: dict[str, Any] = {SET_POSITION[0]: _parameters(), STATE_REQUEST: [], FACTSHEET_REQUEST: []}
    return {
        "typeSpecification": {
            "seriesName": "robot",
            "agvKinematic": "DIFF",
            "agvClass": "CARRIER",
            "maxLoadMass": 0.0,
            "localizationTypes": ["NATURAL"],
            "navigationTypes": ["AUTONOMOUS"],
        },
        "physicalParameters": dict.fromkeys(
            ("speedMin", "speedMax", "accelerationMax", "decelerationMax", "heightMax", "width", "length"),
            0.0,
        ),
        "protocolLimits": {
            "maxStringLens": {},
            "maxArrayLens": {},
            "timing": {"minOrderInterval": 1.0, "minStateInterval": 0.0},
        },
        "protocolFeatures": {
            "optionalParameters": [
                {"parameter": f"state.agvPosition.{name}", "support": "SUPPORTED"}
                for name in ("localizationScore", "deviationRange")
            ],
            "agvActions": [
                {"actionType": kind, "actionScopes": ["INSTANT"], "actionParameters": parameters}
                for kind, parameters in kinds.items()
            ],
        },
        "agvGeometry": {},
        "loadSpecification": {},
    }


def _factsheet_3() -> dict[str, Any]:
    kinds: dict[str, Any] = {SET_POSITION[1]: _parameters(), STATE_REQUEST: [], FACTSHEET_REQUEST: []}
    return {
        "typeSpecification": {
            "seriesName": "robot",
            "mobileRobotKinematics": "DIFFERENTIAL",
            "mobileRobotClass": "CARRIER",
            "maximumLoadMass": 0.0,
            "localizationTypes": ["NATURAL"],
            "navigationTypes": ["AUTONOMOUS"],
        },
        "physicalParameters": dict.fromkeys(
            (
                *("minimumSpeed", "maximumSpeed", "maximumAcceleration", "maximumDeceleration"),
                *("minimumHeight", "maximumHeight", "width", "length"),
            ),
            0.0,
        ),
        "protocolLimits": {
            "maximumStringLengths": {},
            "maximumArrayLengths": {},
            "timing": {"minimumOrderInterval": 1.0, "minimumStateInterval": 0.0},
        },
        "protocolFeatures": {
            "optionalParameters": [
                {"parameter": f"state.mobileRobotPosition.{name}", "support": "SUPPORTED"}
                for name in ("localizationScore", "deviationRange")
            ],
            "mobileRobotActions": [
                {
                    "actionType": kind,
                    "actionScopes": ["INSTANT"],
                    "actionParameters": parameters,
                    "blockingTypes": ["NONE"],
                    "pauseAllowed": False,
                    "cancelAllowed": False,
                }
                for kind, parameters in kinds.items()
            ],
        },
        "mobileRobotGeometry": {},
        "loadSpecification": {},
    }
