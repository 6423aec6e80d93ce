// Everything of the library.
#pragma once

#include "spectex/base.h"
#include "spectex/batch.h"
#include "spectex/coefficient_table.h"
#include "spectex/color.h"
#include "spectex/compare.h"
#include "spectex/evaluation.h"
#include "spectex/heatmap.h"
#include "spectex/io.h"
#include "spectex/methods.h"
#include "spectex/pipeline.h"
#include "spectex/plan.h"
#include "spectex/scene.h"
#include "spectex/solvers.h"
#include "spectex/spectral.h"
#include "spectex/stability.h"
#include "spectex/texture_use.h"
