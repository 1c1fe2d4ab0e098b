# SPDX-License-Identifier: GPL-3.0-or-later
"""The page that shows readings in a browser (docs/live.md).

A process of its own serves it, so that no viewer can delay a reader. Whatever the source is, its
readings go to one `PageState`, and a `PageServer` sends what is new of it to every viewer. It
describes the plots, too, which the browser draws with the files in `assets/`.
"""
