"""The flag that writes the goldens anew: `pytest tests/goldens --regenerate-goldens`, or `make goldens`."""


def pytest_addoption(parser):
    parser.addoption("--regenerate-goldens", action="store_true", help="write tests/goldens/*.png anew: look at them")
