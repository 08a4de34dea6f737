"""A spring's parameters from one recorded heating and cooling.

The heat model itself is `eldir.built.heat`.
"""
