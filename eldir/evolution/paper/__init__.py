"""Evolution of bodies in the paper's scene: they compete by how well they learn to move.

Evolution of printed robots is in `eldir.evolution.printed`; the search that both use is in
`eldir.evolution.search`.
"""
