# SPDX-License-Identifier: GPL-3.0-or-later
"""What a survey changes in a plan (`adaptation`), and its words (`findings`, `report`)."""
