"""Training of policies. Importing this registers `neuroflight/Attitude-v0` with Gymnasium."""

import gymnasium

ENVIRONMENT_ID = "neuroflight/Attitude-v0"

if ENVIRONMENT_ID not in gymnasium.registry:
    gymnasium.register(ENVIRONMENT_ID, entry_point="training.envs.gym_env:AttitudeEnv")
