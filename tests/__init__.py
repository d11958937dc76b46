"""What tests and the quick forms of other checks share."""

# Two thirds of the quick form's time is compilation, of programs that run for milliseconds: 22 % less without optimization, and a quarter
# less of the rest where a program is compiled by one thread, not in parts for several.
FAST_TO_COMPILE = "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
