"""The reference solver: updated-Lagrangian material points, no discretisation shared with the product."""

from updated_lagrangian.solver import UpdatedLagrangian

__all__ = ["UpdatedLagrangian"]
