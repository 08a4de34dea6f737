"""Measuring the engine: what `eldir benchmark` does. Each module measures one thing and says so in numbers,
which `result.save` writes as JSON beside a plot."""
