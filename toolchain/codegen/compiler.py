"""The pipeline from a policy to its C: optimize, lower, evaluate the self-test vectors, emit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.toolchain.codegen.emit import Emission, emit
from neuroflight.toolchain.codegen.plan import CodePlan, lower
from neuroflight.toolchain.codegen.selftest import selftest_vectors
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.network import Network
from neuroflight.toolchain.passes import Saving, optimize
from neuroflight.toolchain.policy.blob import PolicyBlob, blob_terms, filters_hash
from neuroflight.toolchain.policy.model import PolicyModel


@dataclass(frozen=True, eq=False)
class CompiledPolicy:
    """A policy with each stage of its compilation."""

    policy: PolicyModel
    network: Network  # after optimization: what `toolchain.ir.interpreter` evaluates
    savings: tuple[Saving, ...]
    plan: CodePlan
    blob: PolicyBlob
    emission: Emission


def compile_policy(policy: PolicyModel) -> CompiledPolicy:
    """Compile `policy` to C, the same bytes in every run.

    Raises PolicyError if folding or the self-test leaves float32's range.
    """
    network, savings = optimize(policy.network)
    return compile_network(policy, network, savings)


def compile_network(
    policy: PolicyModel, network: Network, savings: tuple[Saving, ...] = ()
) -> CompiledPolicy:
    """Compile `policy` to C with its network in the form `network`, without optimizing it."""
    plan = lower(policy, network)
    observation, action = selftest_vectors(network)
    if not np.isfinite(action).all():
        raise PolicyError(
            f"the policy answers NaN to finite observations of up to {np.abs(observation).max():g}, "
            "expected numbers; train it anew: its weights are too large for float32"
        )
    blob = PolicyBlob(
        sequence=0,
        architecture_hash=plan.architecture_hash,
        filters_hash=filters_hash(policy.filters),
        control_rate_hz=policy.control_rate_hz,
        terms=blob_terms(policy.blocks, policy.control_rate_hz),
        aircraft=policy.aircraft,
        aircraft_sha256=policy.aircraft_sha256,
        policy_sha256=policy.source_sha256,
        idle=float(np.float32(policy.idle)),
        mix=policy.mix,
        model=policy.model,
        weights=plan.table,
        selftest_observation=observation,
        selftest_action=action,
        selftest_steps=len(observation) if network.recurrent else 1,
    )
    return CompiledPolicy(policy, network, savings, plan, blob, emit(policy, plan, blob))
