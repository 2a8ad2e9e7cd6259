"""Attacks of a careless user and a hostile bench: each counts what broke; tests run a few, the table all."""
