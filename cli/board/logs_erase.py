"""`neuroflight board logs erase`: make all files for logs empty again, over the line."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.board.logs import look, waiting
from neuroflight.cli.board.state import OnPort, connect
from neuroflight.cli.options import Json
from neuroflight.cli.questions import confirm
from neuroflight.cli.report import Account
from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import NeuroflightError


@dataclass(frozen=True, kw_only=True)
class Erase(OnPort):
    """A request to empty all files for logs."""

    yes: Annotated[bool, Option(None, "do not ask")] = False
    copies: Annotated[Path, Option("DIR", "the folder that logs were fetched to (default: this one)")] = (
        Path()
    )
    unfetched: Annotated[bool, Option(None, "erase logs as well that DIR does not hold")] = False
    json: Json = False

    def run(self) -> int:
        """Erase. Returns 0; raises NeuroflightError of one line where nothing was erased."""
        from neuroflight.flash.logs.catalogue import erase, read_entries, settled_info
        from neuroflight.flash.logs.copies import find_copy
        from neuroflight.flash.logs.messages import ERRORS
        from neuroflight.toolchain.contract import LogError

        with one_interrupt(), connect(self.port) as client:
            info = settled_info(client, waiting())
            foreign = info.error is LogError.FOREIGN
            logs = [] if foreign else read_entries(client, info, waiting())
            if foreign and not self.unfetched:
                raise NeuroflightError(f"{client.name}: {ERRORS[info.error]}; nothing was erased")
            if not logs and not foreign:
                return Account(self.json).end({"erased": []}, f"{client.name}: no log is kept there")
            kept = [log for log in logs if log.bytes]
            if not self.unfetched:
                lost = [log for log in kept if find_copy(client, log, self.copies, time.monotonic) is None]
                if lost:
                    numbers = ", ".join(str(log.number) for log in lost)
                    raise NeuroflightError(
                        f"{client.name}: log {numbers} is not in {self.copies.absolute()}, expected a copy; "
                        "`neuroflight board logs fetch --all` gets them, --copies DIR names another folder, "
                        "--unfetched erases them all the same; nothing was erased"
                    )
            what = "what another firmware wrote" if foreign else f"{len(logs)} logs"
            confirm(self.yes, f"erase {what} on {client.name}", "nothing was erased")
            erase(client, waiting())
            info, left = look(client)
        if left:
            raise NeuroflightError(
                f"{client.name}: {len(left)} logs are still there after erasing; erase again"
            )
        document = {"erased": [log.name for log in logs], "empty": info.empty}
        return Account(self.json).end(document, f"{len(logs)} logs erased; room for {info.empty}")
