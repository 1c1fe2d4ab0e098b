# SPDX-License-Identifier: GPL-3.0-or-later
_GR_WIFORCE_COMPLETE=fish_source gr-wiforce | source
