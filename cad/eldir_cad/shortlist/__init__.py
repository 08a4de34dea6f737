"""The shortlist: designs of a run that can be built, ranked by their predicted walk, as a folder.

The walks come from `eldir.built`, the violations from `eldir_cad.checks`.
"""

MAX_DESIGNS = 6
"""Default number of designs on a shortlist; commands read it without importing more."""
SEED = 0
"""Default seed of the samples that rank the designs."""
