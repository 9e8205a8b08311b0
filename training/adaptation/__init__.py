"""A policy refined on what a flight told, and its proof."""
