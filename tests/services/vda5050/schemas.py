"""JSON schemas of what the bridge publishes: the standard's in `standard`, stricter ones by its tables.

Strict: what no table has is an error. Of parts that the bridge leaves empty only the type is checked.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema

Schema = dict[str, Any]

TEXT: Schema = {"type": "string"}
NUMBER: Schema = {"type": "number"}
POSITIVE: Schema = {"type": "number", "minimum": 0}
COUNT: Schema = {"type": "integer", "minimum": 0}
FLAG: Schema = {"type": "boolean"}
EMPTY: Schema = {"type": "array", "maxItems": 0}
SECTION: Schema = {"type": "object"}


def one_of(*values: str) -> Schema:
    return {"enum": list(values)}


def many(item: Schema) -> Schema:
    return {"type": "array", "items": item}


def record(required: Schema, optional: Schema | None = None) -> Schema:
    return {
        "type": "object",
        "properties": required | (optional or {}),
        "required": list(required),
        "additionalProperties": False,
    }


HEADER: Schema = {
    "headerId": COUNT,
    "timestamp": {"type": "string", "pattern": r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d+Z$"},
    "version": TEXT,
    "manufacturer": TEXT,
    "serialNumber": {"type": "string", "pattern": "^[A-Za-z0-9_.:-]+$"},
}
REFERENCES = many(record({"referenceKey": TEXT, "referenceValue": TEXT}))
ANGLE: Schema = {"type": "number", "minimum": -3.14159265359, "maximum": 3.14159265359}


def position(flag: str) -> Schema:
    required = {"x": NUMBER, "y": NUMBER, "theta": ANGLE, "mapId": TEXT, flag: FLAG}
    score = {"type": "number", "minimum": 0, "maximum": 1}
    return record(required, {"localizationScore": score, "deviationRange": POSITIVE})


def errors(*levels: str) -> Schema:
    optional = {"errorReferences": REFERENCES, "errorDescription": TEXT, "errorHint": TEXT}
    return many(record({"errorType": TEXT, "errorLevel": one_of(*levels)}, optional))


def actions(result: str, *more: str) -> Schema:
    status = one_of("WAITING", "INITIALIZING", "RUNNING", "FINISHED", "FAILED", *more)
    return many(record({"actionId": TEXT, "actionStatus": status}, {"actionType": TEXT, result: TEXT}))


def information(words: str) -> Schema:
    return many(record({"infoType": TEXT, "infoLevel": one_of("INFO", "DEBUG")}, {words: TEXT}))


MAPS = many(record({"mapId": TEXT, "mapVersion": TEXT, "mapStatus": one_of("ENABLED", "DISABLED")}))
ORDER: Schema = {
    "orderId": TEXT,
    "orderUpdateId": COUNT,
    "lastNodeId": TEXT,
    "lastNodeSequenceId": COUNT,
    "nodeStates": EMPTY,
    "edgeStates": EMPTY,
    "driving": FLAG,
}
MODES = ("AUTOMATIC", "SEMIAUTOMATIC", "MANUAL", "SERVICE")

STATE = {
    2: record(
        HEADER
        | ORDER
        | {
            "operatingMode": one_of(*MODES, "TEACHIN"),
            "actionStates": actions("resultDescription"),
            "batteryState": record({"batteryCharge": NUMBER, "charging": FLAG}),
            "errors": errors("WARNING", "FATAL"),
            "safetyState": record(
                {"eStop": one_of("AUTOACK", "MANUAL", "REMOTE", "NONE"), "fieldViolation": FLAG}
            ),
        },
        {
            "maps": MAPS,
            "agvPosition": position("positionInitialized"),
            "information": information("infoDescription"),
        },
    ),
    3: record(
        HEADER
        | ORDER
        | {
            "operatingMode": one_of(*MODES, "STARTUP", "INTERVENED", "TEACH_IN"),
            "actionStates": EMPTY,
            "instantActionStates": actions("actionResult", "PAUSED", "RETRIABLE"),
            "powerSupply": record({"stateOfCharge": POSITIVE, "charging": FLAG}),
            "errors": errors("WARNING", "URGENT", "CRITICAL", "FATAL"),
            "safetyState": record(
                {"activeEmergencyStop": one_of("MANUAL", "REMOTE", "NONE"), "fieldViolation": FLAG}
            ),
        },
        {
            "maps": MAPS,
            "mobileRobotPosition": position("localized"),
            "information": information("infoDescriptor"),
        },
    ),
}
VISUALIZATION = {
    2: record(HEADER, {"agvPosition": position("positionInitialized")}),
    3: record(HEADER | {"referenceStateHeaderId": COUNT}, {"mobileRobotPosition": position("localized")}),
}
CONNECTION = {
    2: record(HEADER | {"connectionState": one_of("ONLINE", "OFFLINE", "CONNECTIONBROKEN")}),
    3: record(HEADER | {"connectionState": one_of("ONLINE", "OFFLINE", "HIBERNATING", "CONNECTION_BROKEN")}),
}
PARAMETERS = many(
    record(
        {"key": TEXT, "valueDataType": one_of("BOOL", "NUMBER", "INTEGER", "STRING", "OBJECT", "ARRAY")},
        {"isOptional": FLAG},
    )
)


def _factsheet(
    robot: str, kinematic: str, load: str, physical: tuple[str, ...], limits: tuple[str, str], timing: Schema
) -> Schema:
    action: Schema = {"actionType": TEXT, "actionScopes": many(one_of("INSTANT", "NODE", "EDGE"))}
    later: Schema = {"blockingTypes": many(one_of("NONE", "SOFT", "SINGLE", "HARD"))}
    if robot == "mobileRobot":
        action |= {"pauseAllowed": FLAG, "cancelAllowed": FLAG}
    supported = record({"parameter": TEXT, "support": one_of("SUPPORTED", "REQUIRED")})
    natural, autonomous = many(one_of("NATURAL")), many(one_of("AUTONOMOUS"))
    kind = {"seriesName": TEXT, kinematic: TEXT, f"{robot}Class": TEXT, load: POSITIVE}
    return record(
        HEADER
        | {
            "typeSpecification": record(kind | {"localizationTypes": natural, "navigationTypes": autonomous}),
            "physicalParameters": record(dict.fromkeys(physical, POSITIVE)),
            "protocolLimits": record({limits[0]: SECTION, limits[1]: SECTION, "timing": record(timing)}),
            "protocolFeatures": record(
                {
                    "optionalParameters": many(supported),
                    f"{robot}Actions": many(record(action, {"actionParameters": PARAMETERS} | later)),
                }
            ),
            f"{robot}Geometry": SECTION,
            "loadSpecification": SECTION,
        }
    )


FACTSHEET = {
    2: _factsheet(
        "agv",
        "agvKinematic",
        "maxLoadMass",
        ("speedMin", "speedMax", "accelerationMax", "decelerationMax", "heightMax", "width", "length"),
        ("maxStringLens", "maxArrayLens"),
        {"minOrderInterval": POSITIVE, "minStateInterval": POSITIVE},
    ),
    3: _factsheet(
        "mobileRobot",
        "mobileRobotKinematics",
        "maximumLoadMass",
        (
            *("minimumSpeed", "maximumSpeed", "maximumAcceleration", "maximumDeceleration"),
            *("minimumHeight", "maximumHeight", "width", "length"),
        ),
        ("maximumStringLengths", "maximumArrayLengths"),
        {"minimumOrderInterval": POSITIVE, "minimumStateInterval": POSITIVE},
    ),
}
TOPICS = {
    "state": STATE,
    "visualization": VISUALIZATION,
    "connection": CONNECTION,
    "factsheet": FACTSHEET,
}


@cache
def standard(topic: str, major: int) -> Any:
    """Validator of the standard's own schema."""
    file = Path(__file__).parent / "standard" / str(major) / f"{topic}.schema"
    schema = json.loads(file.read_text(encoding="utf-8"))
    return jsonschema.validators.validator_for(schema)(schema)


def check(topic: str, message: dict[str, Any], major: int) -> None:
    """Raises jsonschema.ValidationError where a message is none of the topic."""
    standard(topic, major).validate(message)
    if topic in TOPICS:
        jsonschema.validate(message, TOPICS[topic][major])
