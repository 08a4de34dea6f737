"""Rollouts as functions that PyTorch differentiates: `simulate`, `simulate_one`, `parameters`. The import
needs PyTorch, which no extra of eldir installs.

Not here: updates of the parameters; the optimisers of PyTorch do them.
"""

from eldir.torch._rollouts import parameters as parameters
from eldir.torch._rollouts import simulate as simulate
from eldir.torch._rollouts import simulate_one as simulate_one
