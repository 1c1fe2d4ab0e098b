// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/attributes.h>

#ifdef gnuradio_wiforce_EXPORTS
#define WIFORCE_API __GR_ATTR_EXPORT
#else
#define WIFORCE_API __GR_ATTR_IMPORT
#endif
