"""`python -m openvox` is `openvox`."""

from openvox.cli import main

if __name__ == "__main__":
    main()
