"""PPO as OpenAI Baselines' PPO1 has it, with its updates in C."""
