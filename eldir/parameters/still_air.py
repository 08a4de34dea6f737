"""Heat that a spring loses to still air, with radiation, and to a stream, by published correlations.

Free convection of a long horizontal cylinder: Churchill and Chu, Int. J. Heat Mass Transfer 18 (1975) 1049,
doi 10.1016/0017-9310(75)90222-7, at the mean of surface and air temperature. Air at 1 atm: Incropera and
DeWitt, Fundamentals of Heat and Mass Transfer, table A.4; the same book expects such correlations to be right
within about 20 %. For thin wires published measurements differ more (Morgan, Adv. Heat Transfer 11 (1975)
199).

The turns of a coil lie closer together than the layer of warm air around a thin wire is thick (a few
millimetres). A coil then loses heat like a solid cylinder of its outer diameter (Langmuir, Phys. Rev. 34
(1912) 401: why lamps have coiled filaments), which is less than the wire alone would lose.
"""

from __future__ import annotations

import numpy as np

from eldir.parameters.springs import SpringParameters

SCATTER = 0.2
"""Part by which the correlation may be too high."""
EMISSIVITY, LEAST_EMISSIVITY = 0.5, 0.2
"""Thermal emissivity of the wire: assumed for its oxide, and, for margins, that of bright metal. It was
measured (Javed et al., Int. J. Thermophys. 45, doi 10.1007/s10765-024-03433-0), not on oxidised wire."""
_STEFAN_BOLTZMANN, _GRAVITY, _ZERO_C = 5.670e-8, 9.81, 273.15
_BURNT = 2000.0  # [C]; no need to know how much hotter
_AIR = np.array(  # temperature [K], conductivity [W/(m K)], kinematic viscosity [m2/s], Prandtl number
    [
        [250.0, 0.0223, 11.44e-6, 0.720],
        [300.0, 0.0263, 15.89e-6, 0.707],
        [350.0, 0.0300, 20.92e-6, 0.700],
        [400.0, 0.0338, 26.41e-6, 0.690],
        [450.0, 0.0373, 32.39e-6, 0.686],
    ]
).T


def free_convection(diameter: float, surface: float, ambient: float) -> float:
    """Coefficient [W/(m2 K)] of a horizontal cylinder of this diameter [m]; temperatures in C."""
    film = (surface + ambient) / 2 + _ZERO_C
    conductivity, viscosity, prandtl = (float(np.interp(film, _AIR[0], row)) for row in _AIR[1:])
    rayleigh = _GRAVITY / film * abs(surface - ambient) * diameter**3 / viscosity**2 * prandtl
    shape = (1 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)
    nusselt: float = (0.60 + 0.387 * rayleigh ** (1 / 6) / shape) ** 2
    return nusselt * conductivity / diameter


def forced_convection(diameter: float, speed: float, surface: float, ambient: float) -> float:
    """Coefficient [W/(m2 K)] of a cylinder of this diameter [m] across a stream of this speed [m/s].

    Churchill and Bernstein, J. Heat Transfer 99 (1977) 300, doi 10.1115/1.3450685.
    """
    film = (surface + ambient) / 2 + _ZERO_C
    conductivity, viscosity, prandtl = (float(np.interp(film, _AIR[0], row)) for row in _AIR[1:])
    reynolds = speed * diameter / viscosity
    slope = 0.62 * reynolds**0.5 * prandtl ** (1 / 3) / (1 + (0.4 / prandtl) ** (2 / 3)) ** 0.25
    nusselt: float = 0.3 + slope * (1 + (reynolds / 282_000) ** 0.625) ** 0.8
    return nusselt * conductivity / diameter


def radiation(surface: float, ambient: float, emissivity: float) -> float:
    """Coefficient [W/(m2 K)] of a surface that sees surroundings at ambient temperature [C]."""
    hot, cold = surface + _ZERO_C, ambient + _ZERO_C
    return emissivity * _STEFAN_BOLTZMANN * (hot + cold) * (hot**2 + cold**2)


def wire_coefficient(diameter: float, surface: float, ambient: float) -> float:
    """Expected coefficient [W/(m2 K)] of a straight wire of this diameter [m] in still air."""
    return free_convection(diameter, surface, ambient) + radiation(surface, ambient, EMISSIVITY)


def least_coefficient(springs: SpringParameters, surface: float) -> float:
    """Smallest coefficient [W/(m2 K)] in still air that must be expected, related to the wire's surface.

    The smaller one of the wire alone and of the coil as a solid cylinder, extended by half of its stroke: a
    hot spring extends, but the robot loads it. Both by `SCATTER` less convection than the correlation says.
    """
    wire, ambient = springs.wire_diameter, springs.ambient
    outer = springs.coil_diameter + wire
    length = springs.turns * wire + abs(springs.hot_length - springs.cold_length) / 2
    share = outer * length / (wire * springs.wire_length)  # of the wire's surface

    def least(diameter: float) -> float:
        convection = (1 - SCATTER) * free_convection(diameter, surface, ambient)
        return convection + radiation(surface, ambient, LEAST_EMISSIVITY)

    return min(least(wire), least(outer) * share)


def hottest_in_still_air(springs: SpringParameters, power: float) -> float:
    """Temperature [C] at which a spring with this heat [W] settles if it loses as little as possible."""
    surface = np.pi * springs.wire_diameter * springs.wire_length
    low, high = springs.ambient, springs.ambient + 1.0

    def excess(temperature: float) -> float:
        return power - least_coefficient(springs, temperature) * surface * (temperature - springs.ambient)

    while excess(high) > 0 and high < _BURNT:
        low, high = high, springs.ambient + 2 * (high - springs.ambient)
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high
