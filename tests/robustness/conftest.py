"""Print the outcomes of fuzzed input at the end of pytest's summary."""


def pytest_terminal_summary(terminalreporter):
    from hostile import outcomes

    for (what, came), number in sorted(outcomes.items()):
        terminalreporter.write_line(f"fuzzed {what}: {number} {came}")
