"""Each fact that C and Python share, in one place: constants and small frozen tables.

`toolchain.rendering.contract_header` renders them as `nf_contract.h` for the firmware, in the order of the
imports below; Python rooms import them from this package. Depends on nothing.
"""

# ruff: noqa: F403, I001
from neuroflight.toolchain.contract.frame_time_sensors import *
from neuroflight.toolchain.contract.receiver import *
from neuroflight.toolchain.contract.safety import *
from neuroflight.toolchain.contract.motors import *
from neuroflight.toolchain.contract.simulator_link import *
from neuroflight.toolchain.contract.observation import *
from neuroflight.toolchain.contract.policy_format import *
from neuroflight.toolchain.contract.image_format import *
from neuroflight.toolchain.contract.board_format import *
from neuroflight.toolchain.contract.msp import *
from neuroflight.toolchain.contract.modes import *
from neuroflight.toolchain.contract.chirp import *
from neuroflight.toolchain.contract.blackbox import *
from neuroflight.toolchain.contract.structs import *
from neuroflight.toolchain.contract.settings import *
from neuroflight.toolchain.contract.msp_fields import *
from neuroflight.toolchain.contract.msp_table import *
from neuroflight.toolchain.contract.msp_layouts import *
from neuroflight.toolchain.contract.msp_configuration import *
from neuroflight.toolchain.contract.msp_messages import *
from neuroflight.toolchain.contract.memory_map import *
