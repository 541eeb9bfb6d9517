"""A region's eigenspace to and from its message."""

from __future__ import annotations

import math

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, RegionSpace
from eigenscan.eigenspace.components import Eigenspace
from eigenscan.eigenspace.embedding import CIRCUMFERENCE, Embedding, Kind
from eigenscan.schemas import model_pb2

_NUMBERS: dict[Kind, model_pb2.Eigenspace.Embedding] = {
    "ring": model_pb2.Eigenspace.EMBEDDING_RING,
    "range": model_pb2.Eigenspace.EMBEDDING_RANGE,
}
_KINDS = {number: kind for kind, number in _NUMBERS.items()}
MOST_COMPONENTS = 256
ROUNDING = 1e-3
"""Largest error of a vector's length."""


def space_to_message(one: RegionSpace) -> model_pb2.Eigenspace:
    """The message of a space."""
    space = one.space
    return model_pb2.Eigenspace(
        embedding=_NUMBERS[one.embedding.kind],
        cap=one.embedding.cap,
        turn=ANALYSIS_TURN,
        beams=space.beams,
        mean=space.mean.tolist(),
        vectors=space.vectors.ravel().tolist(),
        eigenvalues=space.eigenvalues.tolist(),
        total_variance=space.total_variance,
        usual_error=one.usual_error,
    )


def space_from_message(message: model_pb2.Eigenspace) -> RegionSpace:
    """Inverse of space_to_message. Raises ValueError for fields that do not fit together."""
    kind = _KINDS.get(message.embedding)
    if kind is None:
        raise ValueError(f"embedding {message.embedding}: this version knows {', '.join(_NUMBERS)}")
    embedding = Embedding(kind, message.cap)
    if message.turn != ANALYSIS_TURN or not 1 <= message.beams <= message.turn:
        raise ValueError(f"{message.beams} beams of {message.turn} a turn: expected {ANALYSIS_TURN} a turn")
    shape = len(message.eigenvalues), embedding.channels, message.beams
    size = math.prod(shape)
    if not 1 <= shape[0] <= MOST_COMPONENTS or len(message.vectors) != size or len(message.mean) != shape[1]:
        raise ValueError(
            f"{len(message.vectors)} numbers of vectors and {len(message.mean)} of the mean, for "
            f"{shape[0]} components of {shape[1]} channels and {shape[2]} beams"
        )
    numbers = [*message.mean, *message.vectors, *message.eigenvalues]
    if not np.isfinite([*numbers, message.total_variance, message.usual_error]).all():
        raise ValueError("holds numbers that are not finite")
    largest = max(message.cap, CIRCUMFERENCE)
    if max(map(abs, message.mean)) > largest or message.total_variance > size / shape[0] * largest**2:
        raise ValueError(f"a mean or a total variance that no ranges up to {largest:g} m have")
    vectors = np.array(message.vectors, dtype=np.float32).reshape(shape)
    lengths = np.linalg.norm(vectors.reshape(shape[0], -1).astype(np.float64), axis=1)
    if np.abs(lengths - 1.0).max() > ROUNDING or min(message.eigenvalues) < 0 or message.usual_error < 0:
        raise ValueError("expected vectors of unit length, eigenvalues and an usual error of at least 0")
    return RegionSpace(
        embedding,
        Eigenspace(
            np.array(message.mean, dtype=np.float32),
            vectors,
            np.array(message.eigenvalues, dtype=np.float32),
            message.total_variance,
        ),
        message.usual_error,
    )
