"""The differentiable mass-spring engine (Taichi lives here and nowhere else)."""
