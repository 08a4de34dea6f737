"""Which designs of a run to build, ranked, as a folder.

The walks come from `eldir.built`, the faults from `cad.checks`.
"""
