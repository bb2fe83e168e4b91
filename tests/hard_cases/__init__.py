"""Hard cases: one small file each. `benchmarks/studies/hard_cases.py` says how a file is laid out.

`tests/benchmarks/test_hard_cases.py` runs them as tests, `f4x report --only stability` makes a table of them.
"""
