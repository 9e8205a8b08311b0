"""Each fact that C and Python share, in one place: constants and small frozen tables.

`toolchain.rendering.contract_header` renders them as `nf_contract.h` for the firmware, in the order of the
imports below; Python rooms import them from this package. Depends on nothing.
"""

# ruff: noqa: F403, I001
from toolchain.contract.frame_time_sensors import *
from toolchain.contract.receiver import *
from toolchain.contract.safety import *
from toolchain.contract.motors import *
from toolchain.contract.simulator_link import *
from toolchain.contract.observation import *
from toolchain.contract.policy_format import *
from toolchain.contract.image_format import *
from toolchain.contract.msp import *
from toolchain.contract.modes import *
from toolchain.contract.chirp import *
from toolchain.contract.blackbox import *
from toolchain.contract.settings import *
from toolchain.contract.msp_layouts import *
from toolchain.contract.msp_configuration import *
from toolchain.contract.msp_messages import *
from toolchain.contract.memory_map import *
