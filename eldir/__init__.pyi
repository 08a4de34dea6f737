from . import built as built
from .controller import Controller as Controller
from .design import Design as Design
from .design import marked_masses as marked_masses
from .evolution.loop import evolve as evolve
from .evolution.paper.configuration import EvolutionConfig as EvolutionConfig
from .genotype import Genotype as Genotype
from .genotype import random_genotypes as random_genotypes
from .lattice import Lattice as Lattice
from .learning import learn as learn
from .morphology import Morphology as Morphology
from .morphology import develop as develop
from .rollout import loss_and_gradient as loss_and_gradient
from .rollout import losses as losses
from .rollout import simulate as simulate
from .rollout import simulate_one as simulate_one
from .scene import Scene as Scene
from .terrain import Terrain as Terrain
from .training.own_loss import value_and_grad as value_and_grad
from .trajectory import Trajectory as Trajectory

__all__: list[str]
__version__: str
