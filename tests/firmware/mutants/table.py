"""All mutants of the core."""

from __future__ import annotations

from tests.firmware.mutants.app_mutants import APP_MUTANTS
from tests.firmware.mutants.blackbox_mutants import BLACKBOX_MUTANTS
from tests.firmware.mutants.card_mutants import CARD_MUTANTS
from tests.firmware.mutants.command_line_mutants import COMMAND_LINE_MUTANTS
from tests.firmware.mutants.control_mutants import CONTROL_MUTANTS
from tests.firmware.mutants.hal_mutants import HAL_MUTANTS
from tests.firmware.mutants.image_mutants import IMAGE_MUTANTS
from tests.firmware.mutants.joined_mutants import JOINED_MUTANTS
from tests.firmware.mutants.mutant import Mutant
from tests.firmware.mutants.receiver_mutants import RECEIVER_MUTANTS
from tests.firmware.mutants.safety_mutants import SAFETY_MUTANTS
from tests.firmware.mutants.sensing_mutants import SENSING_MUTANTS
from tests.firmware.mutants.storage_mutants import STORAGE_MUTANTS

MUTANTS: tuple[Mutant, ...] = (
    *SENSING_MUTANTS,
    *RECEIVER_MUTANTS,
    *CONTROL_MUTANTS,
    *SAFETY_MUTANTS,
    *STORAGE_MUTANTS,
    *CARD_MUTANTS,
    *IMAGE_MUTANTS,
    *BLACKBOX_MUTANTS,
    *JOINED_MUTANTS,
    *COMMAND_LINE_MUTANTS,
    *APP_MUTANTS,
    *HAL_MUTANTS,
)
