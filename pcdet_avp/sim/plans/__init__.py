"""Garages from a file: ``read`` turns a plan (YAML, by plan.schema.json) into floors, ``check`` says what is wrong."""
