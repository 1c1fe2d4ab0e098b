# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes and what is made of them: what is shipped, the schemas of files, captures and the demo."""
