from .designs import load_run as load_run
from .history import read_history as read_history
from .loop import evolve as evolve
from .loop import resume as resume
from .run_folder import RunFolder as RunFolder
from .run_folder import load_generation as load_generation
from .search import EvolutionConfig as EvolutionConfig
from .search import Search as Search
