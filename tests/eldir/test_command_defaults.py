"""Options of the commands have the defaults and the choices of what they fill."""

import inspect
from collections.abc import Callable
from typing import Any, get_args, get_type_hints

import typer

from eldir.defaults import GENERATIONS, LATTICE, POPULATION, Crossover, EncodingName, Optimiser
from eldir.design import Variant
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.learning import learn
from eldir.training.configuration import TrainingConfig
from eldir_app.commands.coupon import coupon
from eldir_app.commands.evolve import evolve
from eldir_app.commands.packet import packet
from eldir_app.commands.shortlist import shortlist
from eldir_cad.kit.printer import load_printer
from eldir_cad.packet.folder import write_packet
from eldir_cad.shortlist.ranking import rank
from eldir_hardware.markers.registration import DEFAULT_KIND

OUTPUT = {"as_json", "out", "help", "install_completion", "show_completion"}


def options(command: Callable) -> dict[str, Any]:
    """The default of every option but those that only choose what is printed or where it is written."""
    found = {p.name: p for p in typer.main.get_command(_app(command)).params if p.param_type_name == "option"}
    return {name: p.default for name, p in found.items() if name not in OUTPUT}


def default_of(function: Callable, name: str) -> Any:
    return inspect.signature(function).parameters[name].default


def test_evolve_fills_the_configuration_with_its_own_defaults():
    config = EvolutionConfig()
    assert config.scene.terrain.is_flat and config.lattice.rows
    assert options(evolve) == {
        "resume": None,
        "cluster": False,
        "device": None,  # where ELDIR_DEVICE says
        "explain": False,
        "objective": "paper",
        "problem": None,
        "rig": None,
        "lattice": None,  # these three depend on the objective
        "population": None,
        "generations": None,
        "terrain": "flat",
        "precision": config.scene.precision,
        "max_motors": config.max_active,
        "static_margin": config.static_margin,
        "buildable": config.buildable,
        "second_stage": config.second_stage,
        "inherit": config.inherit,
        "optimiser": config.training.optimiser,
        "update_length": None,  # the optimiser's own
        "window": config.scene.window,
        "iterations": config.iterations,
        "randomise": config.randomisation,
        "encoding": config.encoding,
        "crossover": config.crossover,
        "seed": config.seed,
    }
    assert default_of(learn, "iterations") == config.iterations
    size = (config.lattice.rows, config.lattice.columns)
    assert (size, config.population, config.generations) == (LATTICE, POPULATION, GENERATIONS)


def test_choices_of_evolve_are_those_of_the_configuration():
    hints = get_type_hints(evolve)
    assert hints["optimiser"] == get_type_hints(TrainingConfig)["optimiser"] == Optimiser
    assert hints["crossover"] == get_type_hints(EvolutionConfig)["crossover"] == Crossover
    assert hints["encoding"] == get_type_hints(EvolutionConfig)["encoding"] == EncodingName
    help_of = {p.name: p.help for p in typer.main.get_command(_app(evolve)).params}
    for optimiser in get_args(Optimiser):
        assert f"{TrainingConfig(optimiser).update_length:g}" in help_of["update_length"]


def test_shortlist_packet_and_coupon_have_the_defaults_of_what_they_call():
    printer = default_of(load_printer, "name")
    shared = {"printer": printer, "parts": None}
    assert options(shortlist) == shared | {
        "top": default_of(rank, "top"),
        "seed": default_of(rank, "seed"),
        "scene": default_of(rank, "scene"),
    }
    variant = Variant()
    assert options(packet) == shared | {
        "without_motor": variant.without_motor,
        "ballast": variant.ballast,
        "in_series": default_of(write_packet, "in_series"),
        "prices": default_of(write_packet, "prices"),
        "marker": DEFAULT_KIND,
    }
    assert options(coupon) == shared


def _app(command: Callable) -> typer.Typer:
    app = typer.Typer()
    app.command()(command)
    return app
