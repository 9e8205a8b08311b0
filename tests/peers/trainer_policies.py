"""Policies of other trainers, by the trainers' own means: `python trainer_policies.py LINES.json FOLDER`.

A program of its own, because each trainer brings packages of its own (test_trainers.py installs them).
LINES.json: export lines of rows of docs/guides/policies.md and the code before them; FOLDER gets a folder a
policy: the ONNX file, observations, and the actions that the trainer itself answers them with.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import chdir
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from runpy import run_path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

Array = NDArray[Any]
HIDDEN, UNITS = [32, 32], 16  # of a state
RNG = np.random.default_rng(1)
OBSERVATIONS = RNG.normal(0.0, 2.0, (60, 6)).astype(np.float32)  # one after the other
SEEN = RNG.normal(1.0, 3.0, (200, 6)).astype(np.float32)  # by the normalizer
OBSERVED, FRACTIONS = spaces.Box(-np.inf, np.inf, (6,), np.float32), spaces.Box(0.0, 1.0, (4,), np.float32)
LIMITS = spaces.Box(-1.0, 1.0, (4,), np.float32)


class Still(gymnasium.Env[Array, Array]):
    """An environment in which nothing happens: what is exported has not been trained for long."""

    observation_space = OBSERVED

    def __init__(self, actions: spaces.Box = FRACTIONS) -> None:
        self.action_space = actions

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        return np.zeros(6, np.float32), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        return np.zeros(6, np.float32), 0.0, False, False, {}


@dataclass(frozen=True)
class Made:
    """A policy: the names that the line of its row takes, and the trainer's own actions, motor fractions."""

    name: str
    names: dict[str, Any]
    act: Callable[[Array], Any]  # an action an observation, one after the other


def randomize(module: torch.nn.Module) -> None:
    """Set random weights, large enough that the outputs differ: trainers begin with small ones."""
    for parameter in module.parameters():
        torch.nn.init.normal_(parameter, 0.0, max(1, parameter.shape[-1]) ** -0.5)


def tensor(values: Array) -> torch.Tensor:
    return torch.as_tensor(values)


def answers(policy: Any) -> Callable[[Array], Any]:
    """Return a function that gives a torch module's actions for a batch."""
    return lambda observations: policy(tensor(observations))


def clipped(actions: Any) -> Array:
    """Limit actions to 0..1, as the environment does."""
    return np.asarray(np.clip(actions, 0.0, 1.0))


# --- Stable-Baselines3 --------------------------------------------------------------------------------
def _stable(name: str, policy: str = "MlpPolicy", env: Any = None, **more: Any) -> Any:
    import sb3_contrib
    import stable_baselines3

    learner = getattr(stable_baselines3, name, None) or getattr(sb3_contrib, name)
    model = learner(policy, env or Still(), policy_kwargs={"net_arch": HIDDEN} | more, device="cpu", seed=1)
    randomize(model.policy)
    return model


def _predicted(*names: str) -> Iterator[Made]:
    for name in names:
        model = _stable(name)
        yield Made(name, {"model": model}, _deterministic(model))


def _deterministic(model: Any) -> Callable[[Array], Any]:
    return lambda observations: model.predict(observations, deterministic=True)[0]


def stable_ppo() -> Iterator[Made]:
    yield from _predicted("PPO", "A2C", "TRPO")


def stable_normalized() -> Iterator[Made]:
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = VecNormalize(DummyVecEnv([Still]))
    env.obs_rms.update(SEEN)
    env.training = False
    model = _stable("PPO", env=env)
    yield Made(
        "PPO-normalized",
        {"model": model, "env": env},
        lambda o: model.predict(env.normalize_obs(o), deterministic=True)[0],
    )


def stable_sac() -> Iterator[Made]:
    yield from _predicted("SAC", "TQC", "CrossQ")


def stable_td3() -> Iterator[Made]:
    yield from _predicted("TD3", "DDPG")


def stable_recurrent() -> Iterator[Made]:
    model = _stable("RecurrentPPO", "MlpLstmPolicy", lstm_hidden_size=UNITS)

    def act(observations: Array) -> list[Array]:
        state, actions = None, []
        for number, observation in enumerate(observations):
            begins = np.array([number == 0])
            action, state = model.predict(observation, state, begins, deterministic=True)
            actions.append(action)
        return actions

    yield Made("RecurrentPPO", {"model": model}, act)


# --- CleanRL ------------------------------------------------------------------------------------------
def _clean() -> Any:
    wrapped = gymnasium.wrappers.NormalizeObservation
    return gymnasium.vector.SyncVectorEnv([lambda: wrapped(gymnasium.wrappers.ClipAction(Still()))])


def cleanrl_ppo() -> Iterator[Made]:
    from cleanrl.ppo_continuous_action import Agent

    envs = _clean()
    agent = Agent(envs)
    randomize(agent)
    (env,) = envs.envs
    for observation in SEEN:
        env.observation(observation)
    env.update_running_mean = False

    def act(observations: Array) -> Array:
        seen = np.clip([env.observation(each) for each in observations], -10.0, 10.0).astype(np.float32)
        return clipped(agent.actor_mean(tensor(seen)))

    yield Made("cleanrl-ppo", {"agent": agent, "envs": envs}, act)


def cleanrl_sac() -> Iterator[Made]:
    from cleanrl.sac_continuous_action import Actor

    actor = Actor(_single())
    randomize(actor)
    yield Made("cleanrl-sac", {"actor": actor}, lambda o: actor.get_action(tensor(o))[2])


def cleanrl_td3() -> Iterator[Made]:
    from cleanrl import ddpg_continuous_action, td3_continuous_action

    for name, actor in (
        ("cleanrl-td3", td3_continuous_action.Actor(_single())),
        ("cleanrl-ddpg", ddpg_continuous_action.Actor(_single())),
    ):
        randomize(actor)
        yield Made(name, {"actor": actor}, answers(actor))


def _single() -> Any:
    envs = _clean()
    envs.action_space = FRACTIONS  # of one environment, as the script's scale of actions is to have
    return envs


# --- skrl ---------------------------------------------------------------------------------------------
def skrl() -> Iterator[Made]:
    from skrl.agents.torch.ppo import PPO
    from skrl.resources.preprocessors.torch import RunningStandardScaler
    from skrl.utils.model_instantiators.torch import gaussian_model

    layers = {"name": "net", "input": "OBSERVATIONS", "layers": HIDDEN, "activations": "elu"}
    space = {"observation_space": OBSERVED, "action_space": FRACTIONS, "device": "cpu"}
    policy = gaussian_model(**space, network=[layers], output="ACTIONS")
    policy.compute({"observations": tensor(SEEN)}, role="policy")  # its layers learn their inputs
    randomize(policy)
    scaler = {
        "observation_preprocessor": RunningStandardScaler,
        "observation_preprocessor_kwargs": {"size": OBSERVED, "device": "cpu"},
    }
    agent = PPO(models={"policy": policy, "value": policy}, **space, cfg=scaler)
    agent._observation_preprocessor(tensor(SEEN), train=True)

    def act(observations: Array) -> Array:
        _, told = agent.act(tensor(observations), None, timestep=0, timesteps=1)
        return clipped(told["mean_actions"])

    yield Made("skrl-ppo", {"agent": agent}, act)


# --- rsl_rl and IsaacLab ------------------------------------------------------------------------------
def _observed(observations: Array) -> Any:
    from tensordict import TensorDict

    return TensorDict({"policy": tensor(observations)}, batch_size=[len(observations)])


def _in_turn(policy: Callable[[Any], torch.Tensor]) -> Callable[[Array], Array]:
    """Return a function that gives actions one observation at a time, so that state is carried."""
    return lambda observations: clipped([policy(_observed(o[None]))[0].numpy() for o in observations])


def rsl_rl() -> Iterator[Made]:
    from rsl_rl.env import VecEnv
    from rsl_rl.runners import OnPolicyRunner

    class Stills(VecEnv):  # type: ignore[misc]
        num_envs, num_actions, max_episode_length, device = 8, 4, 10, "cpu"
        cfg: dict[str, Any] = {}  # noqa: RUF012 - the interface is the trainer's
        episode_length_buf = torch.zeros(8, dtype=torch.long)

        def get_observations(self) -> Any:
            return _observed(SEEN[:8])

        def step(self, actions: torch.Tensor) -> tuple[Any, ...]:
            return self.get_observations(), torch.zeros(8), torch.zeros(8, dtype=torch.bool), {}

    for kind in ("mlp", "gru", "lstm"):
        recurrent = {"class_name": "RNNModel", "rnn_type": kind, "rnn_hidden_dim": UNITS}
        model = {"hidden_dims": HIDDEN, "activation": "elu", "obs_normalization": True}
        model |= {"class_name": "MLPModel"} if kind == "mlp" else recurrent
        config = {
            "num_steps_per_env": 4,
            "save_interval": 10,
            "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
            "algorithm": {"class_name": "PPO"},
            "actor": model | {"distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 1.0}},
            "critic": model,
        }
        runner = OnPolicyRunner(Stills(), config, log_dir=None, device="cpu")
        runner.alg.get_policy().update_normalization(_observed(SEEN))
        randomize(runner.alg.get_policy().mlp)
        yield Made(f"rsl-{kind}", {"runner": runner}, _in_turn(runner.get_inference_policy(device="cpu")))


def isaaclab() -> Iterator[Made]:
    # Loaded by path: importing the package around it would start Isaac Sim.
    found = find_spec("isaaclab")
    assert found is not None and found.origin is not None
    place = Path(found.origin).parent / "source" / "isaaclab_rl" / "isaaclab_rl" / "rsl_rl" / "exporter.py"
    export = run_path(str(place))["export_policy_as_onnx"]
    from rsl_rl.modules import ActorCritic, ActorCriticRecurrent

    groups = {"policy": ["policy"], "critic": ["policy"]}
    both = {"actor_hidden_dims": HIDDEN, "critic_hidden_dims": HIDDEN, "actor_obs_normalization": True}
    for kind in ("mlp", "gru", "lstm"):
        make, more = ActorCritic, dict[str, Any]()
        if kind != "mlp":
            make, more = (
                ActorCriticRecurrent,
                {"rnn_type": kind, "rnn_hidden_dim": UNITS, "rnn_num_layers": 1},
            )
        policy = make(_observed(SEEN), groups, 4, **both, **more)
        randomize(policy.actor)
        policy.update_normalization(_observed(SEEN))
        policy.eval()
        names = {"policy": policy, "export_policy_as_onnx": export}
        yield Made(f"isaaclab-{kind}", names, _in_turn(policy.act_inference))


# --- rl_games and tianshou ----------------------------------------------------------------------------
def rl_games() -> Iterator[Made]:
    from rl_games.algos_torch.model_builder import ModelBuilder
    from rl_games.algos_torch.players import rescale_actions

    continuous = {
        "mu_activation": "None",
        "sigma_activation": "None",
        "mu_init": {"name": "default"},
        "sigma_init": {"name": "const_initializer", "val": 0},
        "fixed_sigma": True,
    }
    network: dict[str, Any] = {
        "name": "actor_critic",
        "separate": False,
        "space": {"continuous": continuous},
        "mlp": {"units": HIDDEN, "activation": "elu", "initializer": {"name": "default"}},
    }
    shapes = {"actions_num": 4, "input_shape": (6,), "num_seqs": 1, "value_size": 1}
    for kind in ("mlp", "gru", "lstm"):
        cell = {"name": kind, "units": UNITS, "layers": 1, "before_mlp": True, "concat_output": False}
        parts = network if kind == "mlp" else network | {"rnn": cell}
        builder = ModelBuilder().load({"model": {"name": "continuous_a2c_logstd"}, "network": parts})
        model = builder.build(shapes | {"normalize_value": True, "normalize_input": True})
        randomize(model.a2c_network)
        model.train()
        model.norm_obs(tensor(SEEN))
        model.eval()

        def act(observations: Array, model: Any = model) -> list[Array]:
            states, actions = model.get_default_rnn_state(), []
            for observation in observations:
                told = {"obs": tensor(observation[None]), "rnn_states": states, "is_train": False}
                answer = model(told | {"prev_actions": None})
                states, mean = answer["rnn_states"], answer["mus"].clamp(-1.0, 1.0)
                actions.append(rescale_actions(torch.zeros(4), torch.ones(4), mean)[0].numpy())
            return actions

        yield Made(f"rl-games-{kind}", {"model": model}, act)


def _tianshou(actor: Any, make: Callable[[Any], Any], name: str) -> Made:
    policy = make(actor)
    randomize(policy.actor)
    policy.eval()
    return Made(name, {"policy": policy}, lambda o: [policy.compute_action(each) for each in o])


def tianshou_ppo() -> Iterator[Made]:
    from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
    from tianshou.utils.net.common import Net
    from tianshou.utils.net.continuous import ContinuousActorProbabilistic
    from torch.distributions import Independent, Normal

    net = Net(state_shape=(6,), hidden_sizes=HIDDEN, activation=torch.nn.Tanh)
    yield _tianshou(
        ContinuousActorProbabilistic(preprocess_net=net, action_shape=(4,), unbounded=True),
        lambda actor: ProbabilisticActorPolicy(
            actor=actor,
            dist_fn=lambda told: Independent(Normal(*told), 1),
            deterministic_eval=True,
            action_space=FRACTIONS,
            observation_space=OBSERVED,
        ),
        "tianshou-ppo",
    )


def tianshou_sac() -> Iterator[Made]:
    from tianshou.algorithm.modelfree.sac import SACPolicy
    from tianshou.utils.net.common import Net
    from tianshou.utils.net.continuous import ContinuousActorProbabilistic

    net = Net(state_shape=(6,), hidden_sizes=HIDDEN)
    yield _tianshou(
        ContinuousActorProbabilistic(
            preprocess_net=net, action_shape=(4,), unbounded=True, conditioned_sigma=True
        ),
        lambda actor: SACPolicy(actor=actor, action_space=FRACTIONS, observation_space=OBSERVED),
        "tianshou-sac",
    )


def tianshou_td3() -> Iterator[Made]:
    from tianshou.algorithm.modelfree.ddpg import ContinuousDeterministicPolicy
    from tianshou.utils.net.common import Net
    from tianshou.utils.net.continuous import ContinuousActorDeterministic

    net = Net(state_shape=(6,), hidden_sizes=HIDDEN)
    yield _tianshou(
        ContinuousActorDeterministic(preprocess_net=net, action_shape=(4,)),
        lambda actor: ContinuousDeterministicPolicy(
            actor=actor, action_space=FRACTIONS, observation_space=OBSERVED
        ),
        "tianshou-td3",
    )


# --- Without torch ------------------------------------------------------------------------------------
def _clipping(policy: Callable[[Array], Any]) -> Callable[[Array], Array]:
    return lambda observations: clipped(policy(observations))


def brax() -> Iterator[Made]:
    import jax
    import onnx
    from brax.training.acme import running_statistics, specs
    from brax.training.agents.ppo import networks
    from jax2onnx import to_onnx

    net = networks.make_ppo_networks(
        6, 4, preprocess_observations_fn=running_statistics.normalize, policy_hidden_layer_sizes=HIDDEN
    )
    normalizer = running_statistics.init_state(specs.Array((6,), np.float32))
    key = jax.random.PRNGKey(0)
    params = (
        running_statistics.update(normalizer, SEEN),
        net.policy_network.init(key),
        net.value_network.init(key),
    )
    policy = networks.make_inference_fn(net)(params, deterministic=True)
    names = {"policy": policy, "key": key, "to_onnx": to_onnx, "onnx": onnx}
    yield Made("brax-ppo", names, lambda o: (np.asarray(policy(o, key)[0]) + 1.0) / 2.0)


def flax() -> Iterator[Made]:
    import jax
    import onnx
    from flax import linen, nnx
    from jax2onnx import to_onnx

    class Nnx(nnx.Module):  # type: ignore[misc]
        def __init__(self) -> None:
            streams = nnx.Rngs(0)
            self.first, self.last = nnx.Linear(6, 32, rngs=streams), nnx.Linear(32, 4, rngs=streams)

        def __call__(self, observation: Any) -> Any:
            return self.last(nnx.gelu(self.first(observation)))

    class Linen(linen.Module):  # type: ignore[misc]
        @linen.compact  # type: ignore[untyped-decorator]
        def __call__(self, observation: Any) -> Any:
            return linen.Dense(4)(linen.swish(linen.LayerNorm()(linen.Dense(32)(observation))))

    module = Linen()
    variables = module.init(jax.random.PRNGKey(0), SEEN[:1])
    for name, policy in (("flax-nnx", Nnx()), ("flax-linen", lambda o: module.apply(variables, o))):
        names = {"policy": policy, "to_onnx": to_onnx, "onnx": onnx}
        yield Made(name, names, _clipping(policy))


def keras() -> Iterator[Made]:
    from keras import Sequential, layers

    scale = 1.0 / SEEN.std(0)
    model = Sequential(
        [
            layers.Input((6,)),
            layers.Rescaling(scale.tolist(), (-SEEN.mean(0) * scale).tolist()),
            layers.Dense(32),
            layers.LayerNormalization(),
            layers.Activation("swish"),
            layers.Dense(32, activation="tanh"),
            layers.Dense(4),
        ]
    )
    model.predict(SEEN, verbose=0)
    yield Made("keras", {"model": model}, lambda o: clipped(model.predict(o, verbose=0)))


def sklearn() -> Iterator[Made]:
    import onnx
    from skl2onnx import to_onnx
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    actions = 1.0 / (1.0 + np.exp(-SEEN[:, :4]))
    for activation in ("tanh", "relu"):
        network = MLPRegressor(hidden_layer_sizes=HIDDEN, activation=activation, max_iter=40, random_state=1)
        model = make_pipeline(StandardScaler(), network).fit(SEEN, actions)
        names = {"model": model, "to_onnx": to_onnx, "onnx": onnx, "np": np}
        yield Made(f"sklearn-{activation}", names, _clipping(model.predict))


POLICIES: dict[str, Callable[[], Iterator[Made]]] = {  # by the first cell of a row
    "Stable-Baselines3 PPO, A2C; sb3-contrib TRPO": stable_ppo,
    "the same behind VecNormalize": stable_normalized,
    "Stable-Baselines3 SAC; sb3-contrib TQC, CrossQ": stable_sac,
    "Stable-Baselines3 TD3, DDPG": stable_td3,
    "sb3-contrib RecurrentPPO": stable_recurrent,
    "CleanRL PPO": cleanrl_ppo,
    "CleanRL SAC": cleanrl_sac,
    "CleanRL DDPG, TD3": cleanrl_td3,
    "skrl": skrl,
    "rsl_rl: MLP, GRU, LSTM": rsl_rl,
    "IsaacLab with rsl_rl: MLP, GRU, LSTM": isaaclab,
    "rl_games: MLP, GRU, LSTM": rl_games,
    "tianshou PPO, A2C": tianshou_ppo,
    "tianshou SAC": tianshou_sac,
    "tianshou DDPG, TD3": tianshou_td3,
    "Brax": brax,
    "flax: nnx, linen": flax,
    "Keras": keras,
    "scikit-learn MLPRegressor": sklearn,
}


def main(lines: Path, folder: Path) -> None:
    """Make every policy of the rows, export it by the row's line and write what the trainer answers."""
    told = json.loads(lines.read_text())
    torch.manual_seed(1)
    for row, line in told["lines"].items():
        for made in POLICIES[row]():
            own = folder / made.name
            own.mkdir()
            scope: dict[str, Any] = {}
            with chdir(own):
                exec(told["before"], scope)
                exec(line, scope | made.names)
            with torch.no_grad():
                actions = np.asarray(made.act(OBSERVATIONS), np.float32)
            np.savez(own / "answers.npz", row=row, observations=OBSERVATIONS, actions=actions)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
