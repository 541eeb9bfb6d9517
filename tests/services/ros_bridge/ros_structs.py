"""ROS 2's messages as structs of an IDL library, Cyclone DDS's or pycdr2's, by rosbags' definitions."""

from __future__ import annotations

import types
from dataclasses import dataclass
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

PARTICLES = {
    "nav2_msgs/msg/Particle": "geometry_msgs/Pose pose\nfloat64 weight\n",
    "nav2_msgs/msg/ParticleCloud": "std_msgs/Header header\nnav2_msgs/Particle[] particles\n",
}
"""Those that rosbags lacks."""
WORDS: dict[str, type[Any]] = {"string": str, "bool": bool}


class Structs:
    """The struct of each message, such as `structs["std_msgs/msg/Header"]`, under its name in DDS.

    `base` is the library's IdlStruct, `kinds` its module of types.
    """

    def __init__(self, base: type[Any], kinds: types.ModuleType) -> None:
        self._base, self._kinds = base, kinds
        self._known: dict[str, type[Any]] = {}
        self._store = get_typestore(Stores.ROS2_JAZZY)
        for name, text in PARTICLES.items():
            self._store.register(get_types_from_msg(text, name))

    def __getitem__(self, name: str) -> type[Any]:
        if name not in self._known:
            package, folder, last = name.split("/")
            fields = {each: self._kind(node) for each, node in self._store.fielddefs[name][1]}
            content = {"__annotations__": fields, "__module__": __name__}
            typename = {"typename": f"{package}::{folder}::dds_::{last}_"}
            made = types.new_class(last, (self._base,), typename, lambda space: space.update(content))
            self._known[name] = dataclass(made)
        return self._known[name]

    def _kind(self, node: Any) -> Any:
        sort, what = node
        if sort is Nodetype.NAME:
            return self[what]
        if sort is Nodetype.BASE:
            name = "uint8" if what[0] in ("char", "byte") else what[0]  # as ROS 2 has them
            return WORDS.get(name) or getattr(self._kinds, name)
        element, count = self._kind(what[0]), what[1]
        return self._kinds.array[element, count] if sort is Nodetype.ARRAY else self._kinds.sequence[element]
