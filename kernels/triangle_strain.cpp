// Strain of triangles and its energy, one frame a piece (fingerflow/ops/fields/triangle_strain.py). The equations are
// in triangle_strain_frame.cpp.
// Layout: triangles are arrays (triangles) or (3, triangles) by corner; points (points, 2) and (points, 2, 2) a frame.

#include "interface.h"
#include "parallel.h"
#include "triangle_strain_frame.h"
#include "workspace.h"

void fingerflow_strain_of_triangles(const fingerflow_triangle_strain* given, int threads) {
    using namespace fingerflow;
    const std::int64_t points = given->point_count, count = given->triangle_count;
    const Triangles triangles{count,
                              points,
                              given->corners,
                              given->slopes,
                              given->slopes + 3 * count,
                              given->products,
                              given->areas,
                              given->flat,
                              given->measure == 2 ? 0.0f : 0.5f,
                              given->measure == 0 ? 0.5f : 0.0f,
                              static_cast<float>(given->direct),
                              static_cast<float>(given->between),
                              static_cast<float>(given->shear)};
    parallel_for(given->batch, threads, [&](std::int64_t number) {
        const TriangleFrame frame{given->displacement + 2 * points * number,
                                  given->covariance + 4 * points * number,
                                  given->in_contact + count * number,
                                  given->strain + 3 * count * number,
                                  given->strain_std + 3 * count * number,
                                  given->density + count * number,
                                  given->energy + number,
                                  given->forces + 2 * points * number,
                                  given->own + number};
        const std::size_t bytes = static_cast<std::size_t>(triangle_memory(triangles)) * sizeof(float);
        FINGERFLOW_PICK(strain_of_frame)(triangles, frame, static_cast<float*>(workspace(bytes)));
    });
}
