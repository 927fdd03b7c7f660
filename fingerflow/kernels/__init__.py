"""The binding of the compiled library: typed functions of NumPy arrays or torch tensors, results of the same kind.

A function of `contact`, `fields`, `flow`, `skin` and `tracking` checks its arguments, makes its results and calls the
library. Nothing here imports torch but `tensors`, by which ops call the same functions as ops of torch's own.
"""
