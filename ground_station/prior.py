"""The prior model as the ground station uses it (knowledge = "mesh")."""

from __future__ import annotations

from missions.prior_file import load_prior

__all__ = ["load_prior"]
