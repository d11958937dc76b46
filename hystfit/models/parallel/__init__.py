"""The same programs on an accelerator: associative scans over samples, and one kernel over lanes with the time loop inside."""
