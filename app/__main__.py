"""`python -m avatarrex_studio …` is `avatarrex-studio …`: how torchrun starts a verb."""

from avatarrex_studio.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
