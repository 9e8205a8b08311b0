"""Reads the graph of an ONNX model as a network, refusing whatever it cannot prove.

`checks` refuses whole models, `constants` folds what depends on no observation, `operators`, `arithmetic`,
`patterns` and `recurrent` read one node each, `graph` walks them in order, `door` sees that the motors stay
within [0, 1].
Refusals are PolicyError, one line, naming the node or value.
"""
