# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command: a module per subcommand."""
