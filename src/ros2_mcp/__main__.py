"""The entry point. Claims the streams before anything else is imported, so that nothing can print into MCP."""

import sys


def main() -> None:
    """Runs the `ros2-mcp` command."""
    from ros2_mcp.cli import run

    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
