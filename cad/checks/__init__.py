"""The build filter: whether a design can be printed, assembled and stand; one question a function.

Nothing is written here (`cad.packet`).
"""
