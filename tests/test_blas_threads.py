"""Linear algebra runs in one thread while hystfit computes, and in as many as before afterwards."""

from threadpoolctl import threadpool_info, threadpool_limits

from hystfit.config import one_blas_thread, verb


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_a_public_function_computes_with_one_thread():
    """Two threads took seven times the processor time of a search for terms: they waited for each other."""
    with threadpool_limits(2, "blas"):
        assert verb(threads)() == {1}
        assert threads() == {2}


def test_calls_that_overlap_restore_the_number_when_the_last_one_ends():
    with threadpool_limits(2, "blas"):
        first, second = one_blas_thread(), one_blas_thread()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert threads() == {1}
        second.__exit__(None, None, None)
        assert threads() == {2}
