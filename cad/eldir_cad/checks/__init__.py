"""The build filter: whether a design can be printed and assembled, and whether it stands. Each check is one
function.

This package writes no files (`eldir_cad.packet` does).
"""
