"""Refinement of a policy by what a flight showed, and its proof."""
