"""Networks in place of full material points: action network (finger) and perception network (gel)."""
