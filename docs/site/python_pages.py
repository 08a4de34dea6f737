"""A page for each public module, made from its docstrings."""

from pathlib import Path

from generated import write_pages

import eldir

# Modules whose names a program may use, in the order of the work. Others may change without notice.
MODULES = [
    "eldir.lattice", "eldir.genotype", "eldir.morphology", "eldir.controller", "eldir.terrain", "eldir.scene",
    "eldir.physics", "eldir.rollout", "eldir.learning", "eldir.evolution.search", "eldir.evolution.problem",
    "eldir.evolution.archive", "eldir.evolution.loop", "eldir.evolution.workers", "eldir.evolution.variation",
    "eldir.evolution.run_folder", "eldir.evolution.tables", "eldir.evolution.designs",
    "eldir.evolution.status", "eldir.evolution.figures", "eldir.evolution.best_walks",
    "eldir.evolution.cluster",
    "eldir.evolution.paper.configuration", "eldir.evolution.paper.problem", "eldir.evolution.paper.learning",
    "eldir.evolution.paper.encoding", "eldir.evolution.paper.painting", "eldir.evolution.paper.cppn",
    "eldir.evolution.paper.cppn_variation",
    "eldir.evolution.paper.population", "eldir.evolution.paper.run_folder", "eldir.evolution.paper.status",
    "eldir.evolution.paper.history", "eldir.evolution.paper.analysis", "eldir.evolution.paper.robot_tables",
    "eldir.evolution.own.vectors", "eldir.evolution.own.registration", "eldir.evolution.own.run_folder",
    "eldir.design", "eldir.trajectory", "eldir.show", "eldir.errors", "eldir.defaults",
    "eldir.training.configuration", "eldir.training.loop", "eldir.training.fitting",
    "eldir.training.randomisation", "eldir.training.gradients", "eldir.training.own_loss",
    "eldir.training.differentiable",
    "eldir.jax.rollouts",
    "eldir.built.robot", "eldir.built.gait", "eldir.built.heat", "eldir.built.motion", "eldir.built.walking",
    "eldir.built.samples", "eldir.built.screening", "eldir.built.scene", "eldir.built.stability",
    "eldir.built.gait_search", "eldir.built.gait_choice", "eldir.built.ground", "eldir.built.sensitivities",
    "eldir_cad.checks.buildability", "eldir_cad.checks.contacts", "eldir_cad.checks.distances",
    "eldir_cad.checks.kinematics", "eldir_cad.checks.kit_differences", "eldir_cad.checks.strip_law",
    "eldir_cad.checks.violations",
    "eldir_cad.checks.tipping", "eldir_cad.checks.lean", "eldir_cad.checks.lateral_stability",
    "eldir_cad.shortlist.ranking", "eldir_cad.shortlist.folder",
    "eldir_cad.packet.folder", "eldir_cad.packet.manifest", "eldir_cad.packet.coupon",
    "eldir_cad.packet.cost",
    "eldir_cad.packet.shopping", "eldir_cad.packet.wiring_file",
    "eldir_hardware.camera.lens", "eldir_hardware.camera.plane", "eldir_hardware.camera.projection",
    "eldir_hardware.camera.tags", "eldir_hardware.camera.plane_fit", "eldir_hardware.camera.views",
    "eldir_hardware.camera.lens_fit",
    "eldir_hardware.rig.configuration", "eldir_hardware.rig.addresses", "eldir_hardware.rig.board_identity",
    "eldir_hardware.rig.devices", "eldir_hardware.rig.port_holder", "eldir_hardware.rig.sections",
    "eldir_hardware.rig.supply",
    "eldir_hardware.rig.template", "eldir_hardware.planning.plan", "eldir_hardware.planning.tolerance_walks",
    "eldir_hardware.planning.compiler", "eldir_hardware.planning.hold",
    "eldir_hardware.planning.model_export", "eldir_hardware.planning.workshop", "eldir_hardware.schedule",
    "eldir_hardware.clock", "eldir_hardware.current_sensor", "eldir_hardware.realtime",
    "eldir_hardware.resource",
    "eldir_hardware.testing", "eldir_hardware.thermometer", "eldir_hardware.run.drive",
    "eldir_hardware.run.player", "eldir_hardware.run.filming", "eldir_hardware.run.remote_control",
    "eldir_hardware.run.room", "eldir_hardware.run.virtual_runs",
    "eldir_hardware.guardian.bank", "eldir_hardware.guardian.client", "eldir_hardware.guardian.measured_heat",
    "eldir_hardware.guardian.measured_power",
    "eldir_hardware.guardian.pulse_controller", "eldir_hardware.guardian.off_proof",
    "eldir_hardware.relay.board",
    "eldir_hardware.relay.registration", "eldir_hardware.relay.a0", "eldir_hardware.relay.errors",
    "eldir_hardware.relay.feedback", "eldir_hardware.relay.gd32", "eldir_hardware.relay.lcus",
    "eldir_hardware.relay.line", "eldir_hardware.relay.modbus", "eldir_hardware.relay.mosfet",
    "eldir_hardware.relay.numato", "eldir_hardware.relay.sainsmart", "eldir_hardware.emulator.board",
    "eldir_hardware.emulator.a0", "eldir_hardware.emulator.current_sensor", "eldir_hardware.emulator.modbus",
    "eldir_hardware.emulator.mosfet", "eldir_hardware.emulator.numato", "eldir_hardware.emulator.sainsmart",
    "eldir_hardware.log.reader", "eldir_hardware.log.background", "eldir_hardware.log.following",
    "eldir_hardware.log.mcap_file", "eldir_hardware.log.messages", "eldir_hardware.log.recorder",
    "eldir_hardware.log.recover", "eldir_hardware.markers.registration", "eldir_hardware.markers.tracker",
    "eldir_hardware.markers.disc", "eldir_hardware.markers.discs", "eldir_hardware.markers.squares",
    "eldir_hardware.markers.sheet", "eldir_hardware.markers.placement", "eldir_hardware.vision.sources",
    "eldir_hardware.vision.recording_setup", "eldir_hardware.vision.pipeline",
    "eldir_hardware.vision.tracking_quality", "eldir_hardware.vision.printed_ground",
    "eldir_hardware.vision.whole_body", "eldir_hardware.vision.virtual_camera",
    "eldir_hardware.vision.out_of_plane", "eldir_hardware.vision.solid_robot", "eldir_hardware.virtual.rig",
    "eldir_hardware.virtual.springs", "eldir_hardware.virtual.bodies", "eldir_hardware.virtual.mujoco_body",
    "eldir_hardware.virtual.biplane_body", "eldir_hardware.virtual.impossible_motion",
    "eldir_calibration.adaptation.loop", "eldir_calibration.adaptation.choice",
    "eldir_calibration.adaptation.runs", "eldir_calibration.adaptation.films",
    "eldir_calibration.adaptation.faults", "eldir_calibration.adaptation.prior",
    "eldir_calibration.adaptation.heat", "eldir_calibration.adaptation.page",
    "eldir_calibration.dynamics.belief",
    "eldir_calibration.identification.identification", "eldir_calibration.identification.spring_record",
    "eldir_calibration.dynamics.configuration", "eldir_calibration.dynamics.recording",
    "eldir_calibration.dynamics.results", "eldir_calibration.dynamics.verdict",
    "eldir_calibration.dynamics.identifiability", "eldir_calibration.dynamics.figures",
    "eldir_calibration.report.comparison", "eldir_calibration.report.controls",
    "eldir_calibration.report.verdict", "eldir_calibration.report.numbers", "eldir_calibration.report.page",
]  # fmt: skip


def write(docs: Path) -> None:
    """Write docs/generated/python/MODULE.md for every public module."""
    pages = {}
    for name in MODULES:
        short = [n for n in eldir.__all__ if getattr(getattr(eldir, n), "__module__", "") == name]
        also = "".join(f"`eldir.{n}` is `{name}.{n}`. " for n in short)
        pages[name] = f"# {name}\n\n{also}\n\n```{{eval-rst}}\n.. automodule:: {name}\n```\n"
    write_pages(docs / "generated" / "python", pages)
