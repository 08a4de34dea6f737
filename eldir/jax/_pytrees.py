"""Controllers and physics as pytrees, which JAX takes apart and puts together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from eldir.training.differentiable import FIELDS, number_or_array
from eldir.training.own_loss import import_jax

jax = import_jax()


def _unflatten(kind: type[Any], leaves: Sequence[Any]) -> Any:
    """A record of these leaves. Numbers become NumPy's again, so that all of eldir takes the record."""
    numbers = all(isinstance(leaf, jax.Array | np.ndarray | np.generic | float) for leaf in leaves)
    if numbers and not any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
        leaves = [number_or_array(leaf) for leaf in leaves]
    return kind.construct(*leaves)


for _kind, _names in FIELDS.items():
    jax.tree_util.register_pytree_node(
        _kind,
        lambda record, names=_names: ([getattr(record, name) for name in names], None),
        lambda _, leaves, kind=_kind: _unflatten(kind, leaves),
    )
