"""The results as a table for a page, and as a plot of error against time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MIN_ERROR = 1e-17  # an error of 0 has no place on a logarithmic axis


def table(results: dict[str, Any]) -> str:
    """Markdown. Result: the median error of the first loss; or, of printed robots, their walks."""
    machine = results["machine"]["platform"]
    lines = [
        f"Measured on {results['measured']}, {machine['processor']}, {machine['cores']} cores, "
        f"compiler of the engine: {results['machine']['compiler']['chosen']}.",
        "",
        "| comparison | program | time | relative time, median (least to greatest) | result |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, compared in results["comparisons"].items():
        load = " to ".join(map(str, compared["load_average"]))
        head = f"{name}; {compared['clock']}, threads: {compared['threads']}, load {load}"
        for program, values in compared["programs"].items():
            low, high = values["from_to"]
            first = compared.get("first_turn_s", {}).get(program)
            result = _result(values) + (f"; first turn, with compiling: {first:.3g} s" if first else "")
            lines.append(
                f"| {head} | {program} | {_time(values)} | "
                f"{values['times_the_base']:.3g} ({low:.3g} to {high:.3g}) | {result} |"
            )
            head = ""
    return "\n".join(lines) + "\n"


def plot(results: dict[str, Any]) -> Figure:
    """Error of the first loss against the time of a robot-iteration, where there is a common truth; left and
    below is better."""
    from matplotlib.figure import Figure

    compared = {n: c for n, c in results["comparisons"].items() if "iterations" in c}
    figure = Figure(figsize=(4 * len(compared), 3.6), layout="constrained")
    for axes, (name, values) in zip(
        figure.subplots(1, len(compared), squeeze=False)[0], compared.items(), strict=True
    ):
        for program, numbers in values["programs"].items():
            error = max(numbers["loss_error_m"], _MIN_ERROR)
            axes.loglog(numbers["ms_per_robot_iteration"], error, "o", label=program)
        axes.set(title=name, xlabel="robot-iteration [ms]", ylabel="median error of the first loss [m]")
        times = [numbers["ms_per_robot_iteration"] for numbers in values["programs"].values()]
        axes.set(xlim=(min(times) / 5, max(times) * 5))
        axes.margins(y=0.2)
        axes.legend(fontsize="small")
    return figure


def _time(values: dict[str, Any]) -> str:
    if "ms_per_walk" in values:
        return f"{values['ms_per_walk']:.4g} ms a walk"
    return f"{values['ms_per_robot_iteration']:.3g} ms a robot-iteration"


def _result(values: dict[str, Any]) -> str:
    if "walks" in values:
        return "walks " + ", ".join(f"{walk:.2f}" for walk in values["walks"])
    if "processor_time" in values:
        spent = values["processor_time"]
        low, high = spent["from_to"]
        relative = f"{spent['times_the_base']:.3g} ({low:.3g} to {high:.3g})"
        return f"error {values['loss_error_m']:.1g} m; processor time {_time(spent)}, relative {relative}"
    return f"error {values['loss_error_m']:.1g} m"
