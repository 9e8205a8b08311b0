"""DDPG as OpenAI Baselines had it in 2018, with its updates in C."""
