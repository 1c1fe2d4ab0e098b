# SPDX-License-Identifier: GPL-3.0-or-later
"""What all commands share.

Groups of commands imported on first use (`commands`), options and their types (`options`), messages
and progress bars (`log`), exit statuses and interruptions, plots and pages in Markdown, other
processes (`workers`), and what a file states of its origin (`provenance`).
"""
