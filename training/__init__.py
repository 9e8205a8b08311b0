"""Synthesis of policies. Importing this makes `neuroflight/Attitude-v0` known to Gymnasium."""

import gymnasium

ENVIRONMENT_ID = "neuroflight/Attitude-v0"

if ENVIRONMENT_ID not in gymnasium.registry:
    gymnasium.register(ENVIRONMENT_ID, entry_point="training.envs.gym_env:AttitudeEnv")
