"""Logs that a firmware keeps: what there is, getting it over MSP, erasing it."""
