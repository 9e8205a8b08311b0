"""The rewriting of a network: node by node in order of computation, by a pass's local rule."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from neuroflight.toolchain.ir.network import OBSERVATION, Network, Node, output_width, sweep, use_counts
from neuroflight.toolchain.ir.operations import Affine, Concat, Gru, Linear, Lstm, Operation, Slice


@dataclass
class Draft:
    """The network that a rule is writing. Its values are numbered anew as its nodes are."""

    widths: list[int]  # of every value so far
    uses: list[int]  # how many inputs of living nodes each value will be
    nodes: list[Node] = field(default_factory=list)
    # The numbers that each value has in the old network; none for one that a rule has added.
    roles: defaultdict[int, list[int]] = field(default_factory=lambda: defaultdict(list))

    def add(self, operation: Operation, inputs: Sequence[int], name: str = "") -> int:
        """Append a node that nobody takes yet. Returns its value."""
        self.widths.append(output_width(operation, [self.widths[value] for value in inputs]))
        self.nodes.append(Node(operation, tuple(inputs), name))
        self.uses.append(0)
        for value in inputs:
            self.uses[value] += 1
        return len(self.nodes)

    def producer(self, value: int) -> Node | None:
        """Return the node that computes `value`, None for the observation."""
        return None if value == OBSERVATION else self.nodes[value - 1]

    def sole(self, value: int) -> Node | None:
        """Return the node that computes `value` if only one input takes it, so that it may be rewritten."""
        return self.producer(value) if self.uses[value] == 1 else None

    def release(self, values: Sequence[int]) -> None:
        """Note that inputs no longer take `values`; a value that nothing takes releases its inputs, too."""
        released = list(values)
        while released:
            value = released.pop()
            self.uses[value] -= 1
            node = self.producer(value)
            if self.uses[value] == 0 and node is not None:
                released += node.inputs


# What a rule makes of a node of the draft that has the number of a value in the old network: another node in
# its place, an earlier value of the draft that equals it, or None to leave it.
Rule = Callable[[Draft, Node, int], Node | int | None]


def rewrite(network: Network, rule: Rule) -> Network:
    """Apply `rule` to every node, also to rewritten ones; return the same object if nothing changed.

    The rule may add nodes to the draft. It may not replace the last node by an earlier value: that node
    is the Clip that a policy ends with. Nodes that nothing takes any more are dropped.
    """
    uses = use_counts(network)
    draft = Draft([network.inputs], [uses[OBSERVATION]], roles=defaultdict(list, {0: [OBSERVATION]}))
    renamed, changed = [OBSERVATION], False
    for number, old in enumerate(network.nodes, 1):
        if not uses[number]:  # dead: its inputs were never counted
            renamed.append(-1)
            continue
        node = replace(old, inputs=tuple(renamed[value] for value in old.inputs))
        while (better := rule(draft, node, number)) is not None:
            if isinstance(better, int):
                break
            for value in better.inputs:
                draft.uses[value] += 1
            draft.release(node.inputs)
            node, changed = better, True
        if isinstance(better, int) and number < len(network.nodes):
            draft.uses[better] += uses[number]
            draft.release(node.inputs)
            changed = True
        else:
            better = draft.add(node.operation, node.inputs, node.name)
            for value in node.inputs:  # counted already as the old node's
                draft.uses[value] -= 1
            draft.uses[better] = uses[number]
        renamed.append(better)
        draft.roles[better].append(number)
    return sweep(Network(network.inputs, tuple(draft.nodes))) if changed else network


def absorbed(network: Network) -> list[bool]:
    """Return, for each value, True if only operations take it that can absorb an affine map.

    That is a matrix, another affine map, or a Concat or Slice whose result is so.
    """
    result = [True] * (len(network.nodes) + 1)
    result[-1] = False
    for number in range(len(network.nodes), 0, -1):
        node = network.nodes[number - 1]
        takes = isinstance(node.operation, Linear | Affine | Gru | Lstm)
        if not (takes or (isinstance(node.operation, Concat | Slice) and result[number])):
            for value in node.inputs:
                result[value] = False
    return result
