"""From a trained network to a flashable image. The stages, in the order in which a policy passes them:

    policy/freeze.py              checkpoint.pt -> policy.onnx: scaling, network, output range in one model
    policy/import_onnx.py         another trainer's model -> policy.onnx: opset, ends, state, metadata
    policy/model.py               policy.onnx -> PolicyModel: metadata checked against the contract
    reader/                       the ONNX graph -> Network: every operator read, all else refused
    passes/                       Network -> a shorter Network that computes the same
    passes/equivalence.py         the network before and after a pass, compared in onnxruntime
    codegen/lowering.py           Network -> kernel calls and the table of weights
    codegen/scratch_allocation.py values that do not live at the same time share memory
    codegen/plan.py               calls, table, memory and the hash of the architecture, together
    codegen/selftest.py           observations with the exact actions that the firmware must repeat at boot
    policy/blob.py                table, self-test and header as the bytes that are compiled in or uploaded
    codegen/emit.py               plan and blob -> policy.c and policy.h, by rendering/templates
    image/build.py                generated sources and firmware -> image, by make; its report
    boards/, image/stamp.py       a board's facts -> its description, written into the linked image
    verification/                 a policy on torch, onnxruntime, interpreter, host C, Cortex-M7: same actions
    cortex_m7/                    instructions, predicted cycles and stack of what was linked

Beside them: contract/ (facts that C and Python share), ir/ (networks and two ways to evaluate them),
rendering/ (C and pages from templates).
"""
