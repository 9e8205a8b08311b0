"""Reads the graph of an ONNX model as a network, rejecting whatever it does not know.

`checks` rejects whole models, `constants` folds what depends on no observation, `operators`, `arithmetic`,
`patterns` and `recurrent` read one node each, `graph` walks them in order, `output_range` keeps the motors
within [0, 1].
Rejections are PolicyError, one line, naming the node or value.
"""
