"""Identity and state of a firmware of any make."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.flash.board.hints import betaflight_reasons
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.messages import ApiVersion, BoardInfo, BuildInfo, Identity, PolicyInfo
from neuroflight.toolchain.contract import MSP_API_MAJOR, MSP_PROTOCOL_VERSION, Msp
from neuroflight.toolchain.errors import LinkError


@dataclass(frozen=True)
class Info:
    """Identity and state that a firmware reports."""

    variant: str
    version: str
    api: ApiVersion
    board: BoardInfo
    build: BuildInfo
    name: str
    uid: str
    control_period_us: int
    armed: bool
    arming_reasons: tuple[str, ...]  # what forbids arming now
    policy: PolicyInfo | None  # None from a firmware of another make


def is_ours(client: Client) -> bool:
    """Return True if it is this project's firmware, whatever FC_VARIANT says. Raises LinkError."""
    try:
        client.request(Msp.IDENTITY)
    except RefusedError:
        return False
    return True


def own_identity(client: Client) -> Identity | None:
    """Read who a firmware of this project is; None from one of another make. Raises LinkError."""
    try:
        return messages.identity(client.request(Msp.IDENTITY))
    except RefusedError:
        return None


def version_of(client: Client) -> str:
    """Read this project's own version; FC_VERSION gives Betaflight's instead. Raises LinkError."""
    own = own_identity(client)
    return own.version if own is not None else messages.fc_version(client.request(Msp.FC_VERSION))


def check_ours(client: Client, consequence: str) -> None:
    """Raise LinkError unless it is this project's firmware. consequence: what is not done then."""
    if is_ours(client):
        return
    variant = messages.fc_variant(client.request(Msp.FC_VARIANT))
    raise LinkError(
        f"{client.name}: a firmware of another make answers ({variant}), expected Neuroflight's; "
        f"{consequence}: check that this is the right port"
    )


def check_api(client: Client) -> ApiVersion:
    """Read the firmware's MSP version. Raises LinkError for one that this tool does not speak."""
    api = messages.api_version(client.request(Msp.API_VERSION))
    if (api.protocol, api.major) != (MSP_PROTOCOL_VERSION, MSP_API_MAJOR):
        raise LinkError(
            f"the firmware speaks MSP {api.protocol}.{api.major}.{api.minor}, expected "
            f"{MSP_PROTOCOL_VERSION}.{MSP_API_MAJOR}.x; bring it and this tool to the same version"
        )
    return api


def read_info(client: Client) -> Info:
    """Read a firmware's identity and state. Raises LinkError."""
    api = check_api(client)
    own = own_identity(client)
    extended = messages.status_ex(client.request(Msp.STATUS_EX))
    if own is not None:
        reasons = messages.arming_reasons(records.safety(client.request(Msp.SAFETY)).arming_flags)
    else:
        reasons = betaflight_reasons(extended.arming_flags, extended.arming_flag_count)
    return Info(
        variant=messages.fc_variant(client.request(Msp.FC_VARIANT)),
        version=own.version if own is not None else messages.fc_version(client.request(Msp.FC_VERSION)),
        api=api,
        board=messages.board_info(client.request(Msp.BOARD_INFO)),
        build=messages.build_info(client.request(Msp.BUILD_INFO)),
        name=messages.name(client.request(Msp.NAME)),
        uid=messages.uid(client.request(Msp.UID)),
        control_period_us=extended.status.cycle_time_us,
        armed=extended.status.armed,
        arming_reasons=reasons,
        policy=messages.policy_info(client.request(Msp.POLICY_INFO)) if own is not None else None,
    )
