"""The shortlist: designs of a run that can be built, ranked by their predicted walk, as a folder.

The walks come from `eldir.built`, the faults from `eldir_cad.checks`.
"""
