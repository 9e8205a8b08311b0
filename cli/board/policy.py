"""`neuroflight board policy` list, swap, revert: the policy that a board flies, without a new image."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.board.checked import Unchecked
from neuroflight.cli.board.state import OnPort, connect
from neuroflight.cli.options import Json
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_facts, print_json, print_table
from neuroflight.cli.requests import Argument, Option
from neuroflight.toolchain.errors import LinkError, PolicyError

if TYPE_CHECKING:
    from neuroflight.cli.board.known_policies import Known
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.policy.candidate import Candidate
    from neuroflight.flash.policy.slots import Policies, Slot
    from neuroflight.flash.policy.swap import Board

NOT_WRITTEN = "nothing was written"
LOOK = "`neuroflight board policy list` tells"
LATER = "from its next start on (`neuroflight board reboot`), if it passes its self-test"
OldUnchecked = Annotated[bool, Option(None, None)]  # `flash --list` and `flash --revert` took it


@dataclass(frozen=True, kw_only=True)
class PolicyChange(OnPort):
    """A request that changes which policy is flown, with its options."""

    dry_run: Annotated[bool, Option(None, "ask the board, print the plan, write nothing")] = False
    other_aircraft: Annotated[bool, Option(None, "a policy for another aircraft is meant")] = False
    no_reboot: Annotated[
        bool, Option(None, "do not start the board anew: until somebody does it flies what it flew")
    ] = False
    json: Json = False


@contextmanager
def _connected(port: str, unwritten: str) -> Iterator[Client]:
    """Yield a client on the user's port. Raises LinkError with `unwritten` where nobody answers."""
    try:
        client = connect(port)
    except LinkError as error:
        raise LinkError(f"{error}; {unwritten}") from error
    with client:
        yield client


def _board(port: str) -> Board:
    from neuroflight.flash.link.transport import open_transport
    from neuroflight.flash.policy.swap import Board

    return Board(lambda: open_transport(port))


# --- list --------------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class List(OnPort):
    """A request to list the policies in the board's slots."""

    json: Json = False
    unchecked: OldUnchecked = False

    def run(self) -> int:
        """Print the policy in each slot."""
        from neuroflight.flash.board.info import check_ours
        from neuroflight.flash.policy.slots import read_policies

        with _connected(self.port, "nothing is listed") as client:
            check_ours(client, "nothing is listed")
            policies = read_policies(client)
        networks = _networks(policies)
        if self.json:
            print_json(_list_document(policies, networks))
            return 0
        heads = ("place", "flown", "number", "aircraft", "sha256", "network", "state")
        rows = [_row(place, policies, networks) for place in policies.slots]
        print_table("", [heads, *rows], numbers={"number"})
        return 0


def _known(policies: Policies) -> dict[str, Known]:
    from neuroflight.cli.board.known_policies import known_policies

    return known_policies((place.sha256 for place in policies.slots if place.good), Path.cwd())


def _networks(policies: Policies) -> dict[str, str]:
    return {sha256: known.network for sha256, known in _known(policies).items()}


def _row(place: Slot, policies: Policies, networks: dict[str, str]) -> tuple[str, ...]:
    from neuroflight.flash.policy.slots import EMPTY, SHA_SHOWN

    if place.found == EMPTY and not place.flown:
        return (place.name, "", "", "", "", "", "empty")
    return (
        place.name,
        "flown" if place.flown else "",
        str(place.sequence),
        place.aircraft,
        place.sha256[:SHA_SHOWN],
        networks.get(place.sha256, ""),
        _state(place, policies),
    )


def _state(place: Slot, policies: Policies) -> str:
    from neuroflight.flash.link.policy_errors import policy_error

    if place.flown and policies.given_up:
        return "given up; flown until the next start"
    if not place.good:
        return f"not flown: {policy_error(place.found)}"
    if place.flown:
        return "good" if policies.info.good else "BAD: it does not fly"
    return "good, flown from the next start on" if place is policies.after_start() else "good"


def _list_document(policies: Policies, networks: dict[str, str]) -> list[dict[str, Any]]:
    after = policies.after_start()
    return [
        {
            **asdict(place),
            "source": place.source.name,
            "state": _state(place, policies),
            "network": networks.get(place.sha256),
            "next": place is after,
        }
        for place in policies.slots
    ]


# --- policy ------------------------------------------------------------------------------------------
def candidate_of(path: Path) -> Candidate:
    """Return the policy in an ONNX file, compiled. Raises PolicyError, one line."""
    from neuroflight.cli.board.known_policies import one_digest
    from neuroflight.flash.policy.candidate import Candidate
    from neuroflight.toolchain.codegen.compiler import compile_policy
    from neuroflight.toolchain.policy.blob import pack
    from neuroflight.toolchain.policy.model import read_policy

    try:
        policy = read_policy(path)
        if policy.general:
            raise PolicyError(
                f"{path} is a policy for any quadcopter: make your own of it with `neuroflight policy import "
                f"{path} --aircraft FILE --out POLICY.onnx`"
            )
        blob = compile_policy(policy).blob
        pack(blob)  # raises PolicyError for a network that a blob cannot hold
    except PolicyError as error:
        text = str(error) if str(path) in str(error) else f"{path}: {error}"
        raise PolicyError(f"{text}; {NOT_WRITTEN}") from error
    return Candidate(
        file=path.name,
        network=policy.network.text,
        observation=policy.observation,
        observation_count=blob.observation_count,
        action_count=blob.action_count,
        weight_count=int(blob.weights.size),
        architecture_hash=blob.architecture_hash,
        filters_hash=blob.filters_hash,
        control_rate_hz=blob.control_rate_hz,
        idle=blob.idle,
        mix=blob.mix,
        aircraft=blob.aircraft,
        aircraft_sha256=one_digest(blob.aircraft_sha256),
        sha256=blob.policy_sha256,
        blob=lambda sequence: pack(replace(blob, sequence=sequence)),
    )


@dataclass(frozen=True, kw_only=True)
class Swap(PolicyChange):
    """A request to fly another policy of the same architecture."""

    policy: Annotated[Path, Argument("POLICY.onnx", "to fly")]
    force: Annotated[bool, Option(None, "write it though the board holds it")] = False
    unchecked: Unchecked = False

    def run(self) -> int:
        """Write a policy into the slot that is not flown, and start the board with it."""
        from neuroflight.flash.link import messages
        from neuroflight.flash.policy import candidate as candidates
        from neuroflight.flash.policy.ready import check_ready, check_started
        from neuroflight.flash.policy.slots import read_policies
        from neuroflight.toolchain.contract import Msp

        candidate = candidate_of(self.policy)
        try:
            check = _checked(self, candidate)
        except PolicyError as error:
            raise PolicyError(f"{error}; {NOT_WRITTEN}") from error
        with _connected(self.port, NOT_WRITTEN) as client:
            check_ready(client, NOT_WRITTEN)
            policies = read_policies(client)
            check_started(client.name, policies, NOT_WRITTEN)
            flown = _known(policies).get(policies.info.sha256)
            target_name = messages.board_info(client.request(Msp.BOARD_INFO)).target or "MATEKF722"
            candidates.check_fits(
                candidate,
                policies,
                network=flown.network if flown else None,
                aircraft_sha256=flown.aircraft_sha256 if flown else None,
                mend=f"make firmware TARGET={target_name} POLICY={self.policy}",
                other_aircraft=self.other_aircraft,
            )
            return _carry_out(self, client, candidate, policies, check)


def _checked(args: Swap, candidate: Candidate) -> str:
    """Return the verdict of the check on the policy."""
    from neuroflight.cli.board.checked import checked_policy
    from neuroflight.sim.aircraft.digest import EARLIER
    from neuroflight.toolchain.policy.model import read_policy

    trained = read_policy(args.policy).aircraft_sha256
    of = None if args.other_aircraft else EARLIER.get(trained, trained)
    return checked_policy(
        args.policy, candidate.sha256, of, candidate.aircraft, unchecked=args.unchecked or args.dry_run
    )


def _carry_out(args: Swap, client: Client, candidate: Candidate, policies: Policies, check: str) -> int:
    from neuroflight.flash.policy import swap as swaps

    flown, waiting = policies.flown, policies.after_start()
    held = waiting if waiting is not None and waiting.sha256 == candidate.sha256 and not args.force else None
    document = {**_plan(args, candidate, policies, held), "check": check}
    if held is not None and held is flown:
        return _told(args, document, f"the board flies {candidate.file} already, {held.text}; {NOT_WRITTEN}")
    if not args.json:
        print_facts(_plan_rows(document, candidate, policies))
    if args.dry_run:
        return _told(args, document, f"a plan only (--dry-run): {NOT_WRITTEN}")
    board = _board(args.port)
    place = held
    if place is None:
        kept = f"the board goes on with the policy that it flew, unless all was written; {LOOK}"
        with _stopped(kept), progress_bars(args.json) as add:
            client, place = swaps.write(client, candidate, board, add("policy"))
    document["written"], document["sequence"] = place.name, place.sequence
    if args.no_reboot:
        client.close()
        return _told(args, document, f"{candidate.file} stands in {place.name}; the board flies it {LATER}")
    with _stopped(f"{candidate.file} stands in {place.name} and is flown from the next start on; {LOOK}"):
        swaps.start(client, candidate, place, board).close()
    document["flown"] = True
    return _told(
        args, document, f"the board flies {candidate.file} from {place.name}: its self-test passed there"
    )


def _plan(args: Swap, candidate: Candidate, policies: Policies, held: Slot | None) -> dict[str, Any]:
    """Return the plan as JSON data; `flown` tells if the board flies the policy now."""
    from neuroflight.flash.link.transport import line_baud
    from neuroflight.flash.policy import swap as swaps
    from neuroflight.flash.policy.slots import NAMES

    baud, slot, size = line_baud(args.port), swaps.target(policies), candidate.size
    return {
        "file": str(args.policy),
        "network": candidate.network,
        "aircraft": candidate.aircraft,
        "aircraft_sha256": candidate.aircraft_sha256,
        "sha256": candidate.sha256,
        "idle": candidate.idle,
        "mix": candidate.mix.text,
        "bytes": 0 if held else size,
        "slot": held.name if held else NAMES[slot],
        "seconds": 0.0 if held else round(swaps.seconds(size, slot, baud, start=not args.no_reboot), 2),
        "written": None,
        "sequence": None,
        "flown": held is not None and held is policies.flown,
    }


def _plan_rows(document: dict[str, Any], candidate: Candidate, policies: Policies) -> list[tuple[str, str]]:
    from neuroflight.flash.policy.slots import SHA_SHOWN

    sha, idle = candidate.sha256[:SHA_SHOWN], policies.info.idle
    rows = [
        ("policy", f"{candidate.file}: {candidate.network}, aircraft {candidate.aircraft}, sha256 {sha}"),
        ("aircraft", f"{candidate.aircraft}, digest {candidate.aircraft_sha256[:SHA_SHOWN]}"),
        ("flown now", policies.flown_text),
    ]
    if candidate.idle != idle:
        rows.append(
            ("idle", f"{candidate.idle:g} of full throttle, until now {idle:g}: it comes with the policy")
        )
    if candidate.mix is not policies.info.mix:
        rows.append(
            ("mix", f"{candidate.mix.text}, until now {policies.info.mix.text}: it comes with the policy")
        )
    if document["bytes"]:
        told = (
            f"erase {document['slot']}, write {document['bytes']:,} bytes: about {document['seconds']:.1f} s"
        )
    else:
        told = f"nothing to write: {document['slot']} holds it and waits for a start"
    return [*rows, ("check", document["check"]), ("plan", told)]


@contextmanager
def _stopped(consequence: str) -> Iterator[None]:
    """End the command at Ctrl-C in the block, and say what that means for the board."""
    try:
        yield
    except KeyboardInterrupt:
        print(f"neuroflight: stopped by Ctrl-C: {consequence}", file=sys.stderr)
        raise SystemExit(130) from None


def _told(args: PolicyChange, document: dict[str, Any], text: str) -> int:
    if args.json:
        print_json(document)
    else:
        print(text)
    return 0


# --- revert ------------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Revert(PolicyChange):
    """A request to fly the policy that was flown before."""

    unchecked: OldUnchecked = False

    def run(self) -> int:
        """Give the flown slot up, and start the board with the policy before."""
        from neuroflight.flash.policy import revert as reverts
        from neuroflight.flash.policy.ready import check_ready, check_started
        from neuroflight.flash.policy.slots import read_policies

        with _connected(self.port, reverts.UNTOUCHED) as client:
            check_ready(client, reverts.UNTOUCHED)
            policies = read_policies(client)
            check_started(client.name, policies, reverts.UNTOUCHED)
            try:
                flown, before = reverts.plan(policies, other_aircraft=self.other_aircraft)
            except LinkError as error:
                raise LinkError(f"{client.name}: {error}") from error
            document = {
                "given_up": {**asdict(flown), "source": flown.source.name},
                "afterwards": {**asdict(before), "source": before.source.name},
                "done": False,
                "flown": False,
            }
            if not self.json:
                print_facts([("flown now", flown.text), ("afterwards", before.text)])
            if self.dry_run:
                return _told(self, document, f"a plan only (--dry-run): {reverts.UNTOUCHED}")
            with _stopped(f"whether {flown.name} was given up is not known; {LOOK}"):
                reverts.revert(client)
            document["done"] = True
            if self.no_reboot:
                told = f"{flown.name} is given up; the board flies {before.text} {LATER}"
                return _told(self, document, told)
            with _stopped(
                f"{flown.name} was given up: the board flies the other one from its next start on; {LOOK}"
            ):
                reverts.start(client, flown, before, _board(self.port)).close()
            document["flown"] = True
        return _told(self, document, f"the board flies {before.text}: its self-test passed")
