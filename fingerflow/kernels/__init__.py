"""Python interface of the compiled library: typed functions of NumPy arrays or torch tensors.

Results are arrays of the same kind as the arguments. A function of `contact`, `fields`, `flow`, `skin` or `tracking`
checks its arguments, allocates its results and calls the library. Only `tensors` imports torch; it registers the same
functions as ops of torch.
"""
