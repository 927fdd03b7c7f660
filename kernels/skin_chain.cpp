// Skin chains pressed, and derivatives back along the recorded steps (fingerflow/models/skin_implicit.py,
// skin_adjoint.py). The equations are in skin_chain_press.cpp.
// Layout: arrays of doubles with the batch of chains first; a group of chains fills the lanes of a vector, one group a
// piece. A chain alone, and derivatives, run in scalars.

#include "interface.h"
#include "parallel.h"
#include "skin_chain_press.h"
#include "workspace.h"

void fingerflow_press_skin(const fingerflow_skin_chain* given, int threads) {
    using namespace fingerflow;
    const SkinGroup group = FINGERFLOW_PICK(skin_group)(given->count, given->batch);
    const std::int64_t groups = (given->batch + group.chains - 1) / group.chains;
    parallel_for(groups, threads, [&](std::int64_t number) {
        void* const memory = workspace(static_cast<std::size_t>(group.bytes));
        FINGERFLOW_PICK(press_skin)(*given, number * group.chains, group.chains, memory);
    });
}

void fingerflow_press_skin_back(const fingerflow_skin_back* given, int threads) {
    using namespace fingerflow;
    const SkinGroup group = FINGERFLOW_PICK(skin_group)(given->count, 1);
    parallel_for(given->batch, threads, [&](std::int64_t chain) {
        void* const memory = workspace(static_cast<std::size_t>(group.bytes));
        FINGERFLOW_PICK(press_skin_back)(*given, chain, memory);
    });
}
