"""The pipeline from a policy to its C: optimize, lower, evaluate the self-test vectors, emit."""

from __future__ import annotations

from dataclasses import dataclass

from toolchain.emit import Emission, emit
from toolchain.graph import Network
from toolchain.network import PolicyModel
from toolchain.passes import Saving, optimize
from toolchain.plan import Plan, lower
from toolchain.selftest import selftest_vectors


@dataclass(frozen=True, eq=False)
class CompiledPolicy:
    """A policy with each stage of its compilation."""

    policy: PolicyModel
    network: Network  # after optimization: what `toolchain.evaluate` evaluates
    savings: tuple[Saving, ...]
    plan: Plan
    emission: Emission


def compile_policy(policy: PolicyModel) -> CompiledPolicy:
    """The C of `policy`. Deterministic. Raises PolicyError where folding leaves float32's range."""
    network, savings = optimize(policy.network)
    plan = lower(policy, network)
    observation, action = selftest_vectors(network)
    return CompiledPolicy(policy, network, savings, plan, emit(policy, plan, observation, action))
