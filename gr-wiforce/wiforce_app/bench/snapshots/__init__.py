# SPDX-License-Identifier: GPL-3.0-or-later
"""Channel snapshots from the signal model alone, and errors of what is read from them.

`air` makes the snapshots, `chain` reads them, `cases` lists conditions and gives errors against the
bound, and `stress_paths` sends the snapshots through the blocks as samples.
"""
