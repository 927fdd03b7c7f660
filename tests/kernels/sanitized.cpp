// Every kernel on images of awkward sizes whose memory ends right behind them, for a build with sanitizers.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <limits>
#include <utility>
#include <vector>

#include "entry.h"
#include "interface.h"
#include "parallel.h"
#include "pixels.h"

namespace {

int failures = 0;

void expect(bool right, const char* what) {
    if (!right) {
        std::printf("wrong: %s\n", what);
        ++failures;
    }
}

template <class Pixel>
std::vector<Pixel> noise(std::int64_t count, unsigned seed) {
    std::vector<Pixel> values(static_cast<std::size_t>(count));
    for (Pixel& value : values) {
        seed = seed * 1664525u + 1013904223u;
        value = static_cast<Pixel>(seed >> 16 & 255);
    }
    return values;
}

fingerflow_frames first_of(fingerflow_frames frames) {
    frames.batch = 1;
    return frames;
}

void try_all(std::int64_t batch, std::int64_t height, std::int64_t width, int threads) {
    const std::int64_t count = batch * height * width, frame = height * width;
    const auto eight = noise<std::uint8_t>(count, 1);
    const auto sixteen = noise<std::uint16_t>(count, 2);
    const auto real = noise<float>(count, 3);
    const auto mask = noise<std::uint8_t>(count, 4);
    const fingerflow_frames of_eight{eight.data(), batch, height, width, frame, width, 0}, of_sixteen{sixteen.data(), batch, height, width, frame, width, 1},
        of_real{real.data(), batch, height, width, frame, width, 3};
    std::vector<std::uint8_t> bytes(eight.size());
    for (int size : {3, 5, 7, 9, 11}) {
        std::vector<std::uint16_t> wide(sixteen.size());
        fingerflow_median(&of_eight, bytes.data(), size, nullptr, threads);
        fingerflow_median(&of_sixteen, wide.data(), size, nullptr, threads);
    }
    std::vector<float> numbers(static_cast<std::size_t>(7 * batch));
    for (std::int64_t side : {1, 2, 4, 8})
        for (std::int64_t radius : {4, 8, 60}) {
            std::vector<std::uint8_t> holds(mask.size());
            for (std::size_t k = 0; k < mask.size(); ++k) holds[k] = mask[k] > 90;
            std::vector<float> density_margin(static_cast<std::size_t>(batch * ((height + side - 1) / side) * ((width + side - 1) / side)));
            const fingerflow_apparent_contacts regions{holds.data(), density_margin.data(), numbers.data(), batch, height, width, radius, side};
            fingerflow_apparent_contact(&regions, threads);
        }

    std::vector<std::int64_t> counts(static_cast<std::size_t>(batch << 16));
    std::int64_t wanted = 0, inside = 0, all = 0;
    for (unsigned char pixel : mask) wanted += pixel != 0;
    fingerflow_histogram(&of_eight, mask.data(), batch, frame, width, nullptr, 256, counts.data(), threads);
    for (std::int64_t bin = 0; bin < batch * 256; ++bin) inside += counts[static_cast<std::size_t>(bin)];
    fingerflow_histogram(&of_sixteen, nullptr, 0, 0, 0, nullptr, 1 << 16, counts.data(), threads);
    for (std::int64_t bin : counts) all += bin;
    expect(inside == wanted && all == count, "histograms count every pixel inside");

    const std::vector<float> limits(static_cast<std::size_t>(batch), 0.6f);
    const auto black = noise<float>(height * width, 11);
    std::vector<float> gains(limits.size());
    for (const fingerflow_frames& image : {of_eight, of_real}) {
        const fingerflow_lit_frames lit{image, real.data(), black.data(), batch, 1};
        for (int size : {1, 3, 15}) fingerflow_real_contact_mask(&lit, limits.data(), size, bytes.data(), threads);
        std::vector<float> quotients(bytes.size());
        fingerflow_normalize(&lit, limits.data(), quotients.data(), bytes.data(), threads);
        for (std::int64_t side : {8, 16, 40}) fingerflow_illumination_gain(&lit, side, gains.data(), threads);
        std::vector<float> cells(static_cast<std::size_t>(batch * ((height + 3) / 4) * ((width + 3) / 4)));
        fingerflow_contact_of_frames(&lit, limits.data(), 3, 16, 8, 4, bytes.data(), cells.data(), numbers.data(), gains.data(), threads);
        std::vector<float> thresholds(limits.size());
        for (int size : {1, 3, 9})
            for (std::int64_t stride : {1, 3, 8})
                fingerflow_contact_threshold(&lit, gains.data(), size, nullptr, 8, 4, stride, thresholds.data(), threads);
        const std::int64_t down = std::min<std::int64_t>(3, height), along = std::min<std::int64_t>(2, width);
        const std::int64_t lines = (height - down / 2 + down - 1) / down, across = (width - along / 2 + along - 1) / along;
        std::vector<float> means(static_cast<std::size_t>(batch * lines * across)), of_lines(static_cast<std::size_t>(batch * lines));
        for (const auto& blocks : {std::pair<std::int64_t, std::int64_t>{1, 1}, {lines, across}, {(lines + 1) / 2, (across + 2) / 3}})
            fingerflow_block_means(&image, down, along, blocks.first, blocks.second, means.data(), of_lines.data(), threads);
        const auto places = noise<float>(2 * 50 * batch, 12);
        const std::vector<float> transform{0.1f * static_cast<float>(width) / 25.6f, 0, 0, 0, 0.1f * static_cast<float>(height) / 25.6f, 0};
        std::vector<std::uint8_t> inside(static_cast<std::size_t>(50 * batch));
        fingerflow_covered(cells.data(), batch, (height + 3) / 4, (width + 3) / 4, 4, places.data(), 50, transform.data(), inside.data());
    }
    for (std::int32_t samples : {1, 15, 16, 81}) {
        const std::int64_t windows = 20;
        const auto size = static_cast<std::size_t>(windows * samples);
        const auto grey = noise<float>(static_cast<std::int64_t>(6 * size), 13);
        std::vector<float> apart(2 * 9);
        for (std::int64_t bands : {1, 3, 8})
            fingerflow_frame_distances(grey.data(), grey.data() + 2 * windows / 2 * samples, 2, windows / 2, samples, bands, 30, apart.data(), threads);
        std::vector<double> shift(2 * windows), weight(size, 1.0), deviations(windows), excluded(windows);
        const fingerflow_window_shifts shifts{grey.data(), grey.data() + size, grey.data() + 2 * size, shift.data(), weight.data(),
                                              deviations.data(), excluded.data(), windows, samples, 1.0};
        fingerflow_shift_windows(&shifts, threads);
    }
    if (height >= 4 && width >= 4) {
        const std::int64_t points = 40;
        const auto place = noise<std::uint8_t>(2 * points, 5);
        std::vector<float> start, warp, deviation(points, 1.0f), found(2 * points), error(points), covariance(4 * points);
        std::vector<std::int64_t> index;
        for (std::int64_t k = 0; k < points; ++k) {
            start.push_back(static_cast<float>(place[static_cast<std::size_t>(2 * k)] * width / 256) + 0.3f);
            start.push_back(static_cast<float>(place[static_cast<std::size_t>(2 * k + 1)] * height / 256) - 0.4f);
            const float stretch = k % 4 == 3 ? 40.0f : 1.1f;  // some reach over the whole frame
            for (float element : {stretch, 0.1f, -0.05f, 0.9f}) warp.push_back(element);
            index.push_back(k % batch);
        }
        // Of each image all points but those that its number does not divide.
        const std::int64_t each = points / batch, all = each * batch;
        std::vector<std::uint8_t> status(points);
        for (int window : {5, 21, 33})
            for (const float* deformation : {static_cast<const float*>(nullptr), static_cast<const float*>(warp.data())}) {
                std::vector<float> places = start, ends(start.begin(), start.begin() + 2 * all), speed(2 * all, 0.5f);
                std::vector<float> samples(3 * all * window * window), numbers(32 * all), estimate(2 * all);
                places.resize(2 * all);
                const fingerflow_prepared_templates prepared{of_eight, places.data(), deformation, deviation.data(), samples.data(), numbers.data(),
                                                             each, window, 1, 0.0f};
                fingerflow_prepare_templates(&prepared, threads);
                const fingerflow_found_templates followed{of_real, places.data(), samples.data(), numbers.data(), nullptr, ends.data(), speed.data(),
                                                          found.data(), error.data(), covariance.data(), status.data(), estimate.data(), batch, each, 1,
                                                          window, 3, 0.0f, 1.0f, 0.5f};
                fingerflow_find_templates(&followed, threads);
                fingerflow_find_pairs(&of_eight, eight.data(), each, places.data(), deformation, deviation.data(), window, 1, 3, ends.data(), speed.data(), 0.0f, 1.0f, 0.5f, numbers.data(), found.data(), error.data(), covariance.data(), status.data(), estimate.data(), threads);
            }
        for (const fingerflow_frames& image : {of_eight, of_real})
            for (int step : {1, 3}) {
                std::vector<float> windows(static_cast<std::size_t>(points * (8 / step + 1) * (8 / step + 1)));
                const fingerflow_sampled_windows given{image, index.data(), start.data(), warp.data(), windows.data(), points, 4, step};
                fingerflow_sample_windows(&given, threads);
            }
        for (std::int32_t reach : {0, 5}) {
            const fingerflow_search one_way{real.data(), real.data(), index.data(), start.data(), start.data(), found.data(), height, width, points, 31, reach};
            fingerflow_search_windows(&one_way, threads);
            const fingerflow_search_both_ways both{eight.data(), real.data(), index.data(), start.data(), start.data(), found.data(), status.data(),
                                                   frame, width, 0, frame, width, 3, batch, height, width, points, 15, reach, 2.0f};
            fingerflow_search_and_return(&both, threads);
        }
    }
    if (height >= 7 && width >= 7) {
        std::vector<std::uint8_t> everywhere(static_cast<std::size_t>(frame), 1), half(everywhere);
        for (std::size_t k = 0; k < half.size(); k += 2) half[k] = 0;
        const std::int64_t least = std::min(height, width), border = std::min<std::int64_t>(15, (least - 1) / 2);
        for (const std::vector<std::uint8_t>& part : {everywhere, half})
            for (std::int64_t wanted : {std::int64_t(1), std::int64_t(40), frame}) {
                std::vector<float> points(static_cast<std::size_t>(2 * wanted)), responses(static_cast<std::size_t>(wanted));
                const fingerflow_detection of_bytes{first_of(of_eight), part.data(), points.data(), responses.data(), width,
                                                    border, 3, 21, wanted, 0.01f, 1.0f};
                fingerflow_detect_points(&of_bytes, threads);
                const fingerflow_detection of_floats{first_of(of_real), part.data(), points.data(), responses.data(), width,
                                                     3, 1, 90, wanted, 0.0f, 0.0f};
                fingerflow_detect_points(&of_floats, threads);
            }
    }
    if (height >= 3 && width >= 3) {
        std::vector<double> means(static_cast<std::size_t>(batch));
        fingerflow_mean_response(&of_sixteen, means.data(), threads);
    }
}

void try_medians(std::int64_t points, std::int64_t positions, int threads) {
    const std::int64_t batch = 2;
    const auto reference = noise<float>(2 * points, 9), displacement = noise<float>(batch * 2 * points, 10);
    const auto lattice = noise<float>(2 * positions, 11);
    std::vector<float> covariance, ellipses, medians(batch * 5), deviations(batch * 5), shares(batch);
    for (std::int64_t k = 0; k < batch * points; ++k)
        for (float number : {2.0f, 0.5f, 0.5f, 1.0f}) covariance.push_back(number);
    for (float middle : {200.0f, 2000.0f})
        for (float number : {middle, middle, 100.0f, 40.0f, 0.8f, 0.6f}) ellipses.push_back(number);
    // Every third point apart, of which some have no fields.
    std::vector<unsigned char> apart(static_cast<std::size_t>(batch * points));
    for (std::size_t k = 0; k < apart.size(); ++k) apart[k] = k % 3 == 0;
    std::vector<float> fields = noise<float>(batch * 5 * points, 12), deviations_apart(fields.size(), 0.1f);
    for (std::size_t k = 0; k < fields.size(); k += 30) fields[k] = std::numeric_limits<float>::quiet_NaN();
    for (const float* own : {static_cast<const float*>(nullptr), static_cast<const float*>(covariance.data())})
        for (const unsigned char* some : {static_cast<const unsigned char*>(nullptr), static_cast<const unsigned char*>(apart.data())}) {
            const fingerflow_area_medians given{reference.data(), displacement.data(), ellipses.data(), own, lattice.data(),
                                                some, some ? fields.data() : nullptr, some && own ? deviations_apart.data() : nullptr,
                                                medians.data(), own ? deviations.data() : nullptr, shares.data(), batch, 1, points, positions,
                                                0, 5, 50.0, 0.1, 0.3, 0.0, 0.0, 2.0, 0.4, 0.5};
            fingerflow_medians_over_area(&given, threads);
        }
}

void try_triangles(std::int64_t points, std::int64_t count, int threads) {
    const std::int64_t batch = 2;
    const auto displacement = noise<float>(batch * points * 2, 1), covariance = noise<float>(batch * points * 4, 2);
    const auto slopes = noise<float>(6 * count, 3), areas = noise<float>(count, 4), products = noise<float>(9 * count, 5);
    const std::vector<float> flat(static_cast<std::size_t>(count));
    const std::vector<unsigned char> in_contact(static_cast<std::size_t>(batch * count), 1);
    std::vector<std::int32_t> corners(static_cast<std::size_t>(3 * count));
    for (std::size_t k = 0; k < corners.size(); ++k) corners[k] = static_cast<std::int32_t>(static_cast<std::int64_t>(7 * k) % points);
    std::vector<float> strain(static_cast<std::size_t>(batch * count * 3)), deviation(strain.size()), density(in_contact.size());
    std::vector<double> energy(static_cast<std::size_t>(batch)), own(energy.size());
    std::vector<float> forces(static_cast<std::size_t>(batch * points * 2));
    for (std::int64_t measure : {0, 1, 2}) {
        const fingerflow_triangle_strain given{displacement.data(), covariance.data(), in_contact.data(), corners.data(), slopes.data(),
                                               products.data(), areas.data(), flat.data(), strain.data(), deviation.data(), density.data(),
                                               energy.data(), forces.data(), own.data(), batch, points, count, measure, 1, 1, 1};
        fingerflow_strain_of_triangles(&given, threads);
    }
}

template <class Real>
void try_fits(std::int64_t points, std::int64_t queries, std::int64_t components, std::int64_t geometries, int threads) {
    const std::int64_t batch = 2;
    const auto places = noise<Real>(geometries * points * 2, 5), asked = noise<Real>(geometries * queries * 2, 6);
    const auto values = noise<Real>(batch * points * components, 7);
    for (std::int64_t noises : {std::int64_t(0), std::int64_t(1), components * components}) {
        const auto variances = noise<Real>(batch * points * noises, 8);
        std::vector<Real> value(static_cast<std::size_t>(batch * queries * components)), gradient(2 * value.size());
        std::vector<Real> offset(static_cast<std::size_t>(batch * queries)), covariance(4 * components * value.size());
        std::vector<std::int64_t> counts(offset.size());
        const fingerflow_local_fit given{places.data(), values.data(), asked.data(), noises ? variances.data() : nullptr,
                                         geometries, batch, geometries, batch, batch, points, queries, components, noises, 5,
                                         value.data(), gradient.data(), noises ? covariance.data() : nullptr,
                                         counts.data(), offset.data()};
        fingerflow_local_gradients(&given, 50.0, 5.0, sizeof(Real) == 8, threads);
    }
}

void try_deformation(std::int64_t frames, std::int64_t points, int threads) {
    auto start = noise<float>(2 * points, 21), found = noise<float>(2 * frames * points, 22);
    const auto numbers = noise<float>(34 * points, 23), warp = noise<float>(4 * points, 24);
    for (std::size_t k = 0; k < found.size(); k += 14) found[k] = std::numeric_limits<float>::quiet_NaN();
    if (points > 40) start[60] = start[80] = std::numeric_limits<float>::quiet_NaN();
    const std::vector<float> covariance(static_cast<std::size_t>(4 * frames * points), 0.1f);
    std::vector<float> corrected(found.size()), remaining(covariance.size()), deformed(covariance.size()), expected(found.size());
    std::vector<float> shift(static_cast<std::size_t>(frames * points));
    const fingerflow_deformation given{start.data(), found.data(), covariance.data(), numbers.data(), warp.data(), corrected.data(),
                                       remaining.data(), deformed.data(), shift.data(), expected.data(), frames, points, 25, 5, 60.0, 6.0};
    fingerflow_correct_points(&given, threads);
}

void try_outliers(std::int64_t frames, std::int64_t points, std::int64_t neighbours, int threads) {
    const std::int64_t stride = (points + 15) / 16 * 16;
    std::vector<std::int32_t> number(static_cast<std::size_t>(neighbours * stride));
    std::vector<float> within(number.size());
    for (std::int64_t k = 0; k < neighbours; ++k)
        for (std::int64_t point = 0; point < points; ++point) {
            number[static_cast<std::size_t>(k * stride + point)] = static_cast<std::int32_t>((point + k + 1) % points);
            within[static_cast<std::size_t>(k * stride + point)] = k % 5 < 4;
        }
    const auto x = noise<float>(neighbours * stride, 25), y = noise<float>(neighbours * stride, 26);
    auto displacement = noise<float>(2 * frames * points, 27);
    const auto deviation = noise<float>(frames * points, 28);
    displacement[0] = std::numeric_limits<float>::quiet_NaN();
    std::vector<unsigned char> off(deviation.size()), uncertain(deviation.size());
    const fingerflow_outliers given{number.data(), x.data(), y.data(), within.data(), displacement.data(), deviation.data(), off.data(),
                                    uncertain.data(), frames, points, stride, neighbours, 4.0f, 1e-3f, 1e-6f, 3.0f, 4.0f, 5};
    fingerflow_find_outliers(&given, threads);
    expect(off[0] == 0 && uncertain[0] == 0, "a point that is not known is not judged");
}

// Every kernel, with each piece of its work failing in turn: an exception, and no memory that is lost or used again.
void try_faults() {
    using namespace fingerflow;
    for (std::int64_t piece = -1; piece < 4; ++piece) {
        inject_fault(Fault::kNoMemory, piece, Thread::kAny);
        int thrown = 0, tries = 0;
        const auto tried = [&](auto work) {
            ++tries;
            try {
                work();
            } catch (const std::bad_alloc&) {
                ++thrown;
            }
        };
        for (int threads : {1, 3}) {
            tried([&] { try_all(2, 37, 43, threads); });
            tried([&] { try_medians(300, 100, threads); });
            tried([&] { try_triangles(50, 97, threads); });
            tried([&] { try_fits<float>(300, 50, 2, 1, threads); });
            tried([&] { try_deformation(2, 60, threads); });
            tried([&] { try_outliers(2, 200, 16, threads); });
        }
        inject_fault(Fault::kNone, 0, Thread::kAny);
        expect(piece > 0 || thrown == tries, "a fault in the first piece comes out of every kernel");
    }
}

// What Python calls: one block of memory in, a number out, whatever is thrown.
extern "C" int enter_covered(const void* packed);
extern "C" int enter_halve(const void* packed);

void try_entries() {
    using namespace fingerflow;
    const std::vector<float> cells(4, 1.0f), point{0.5f, 0.5f}, transform{1, 0, 0, 0, 1, 0};
    unsigned char covered = 0;
    struct {
        const float* density_margin;
        std::int64_t batch, down, across, side;
        const float* points;
        std::int64_t count;
        const float* transform;
        unsigned char* covered;
    } const given{cells.data(), 1, 2, 2, 1, point.data(), 1, transform.data(), &covered};
    expect(enter_covered(&given) == kDone && covered == 1, "an entry");

    const std::vector<unsigned char> image(16, 7);
    std::vector<float> halved(4);
    struct {
        fingerflow_frames frames;
        float* halved;
        alignas(8) int threads;
    } const whole{{image.data(), 1, 4, 4, 16, 4, kUint8}, halved.data(), 2};
    expect(enter_halve(&whole) == kDone && halved == std::vector<float>(4, 7.0f), "an entry with a pool");
    for (const Fault fault : {Fault::kNoMemory, Fault::kError, Fault::kUnknown}) {
        inject_fault(fault, -1, Thread::kAny);
        const int outcome = enter_halve(&whole);
        inject_fault(Fault::kNone, 0, Thread::kAny);
        expect(outcome == (fault == Fault::kNoMemory ? kNoMemory : kFailed), "the outcome tells what was thrown");
        expect(fault != Fault::kError || std::strcmp(last_message(), "a fault injected by a test") == 0, "and the message");
    }
}

}  // namespace

int main() {
    try_entries();
    try_faults();
    std::int32_t set = -1, taken = -1;
    for (fingerflow_limit_instruction_set(-1, &set); set >= 0; --set) {
        fingerflow_limit_instruction_set(set, &taken);
        for (int threads : {1, 3}) {
            try_all(1, 1, 1, threads);
            try_all(2, 1, 131, threads);
            try_all(1, 70, 1, threads);
            try_all(2, 37, 43, threads);
            try_all(1, 40, 1300, threads);
            try_medians(2, 17, threads);
            try_medians(300, 100, threads);
            try_triangles(3, 1, threads);
            try_triangles(50, 97, threads);
            for (std::int64_t geometries : {1, 2}) {
                try_fits<float>(300, 50, 2, geometries, threads);
                try_fits<double>(37, 1, 3, geometries, threads);
                try_fits<float>(0, 20, 1, geometries, threads);
            }
            try_deformation(1, 300, threads);
            try_deformation(3, 60, threads);
            try_deformation(2, 1, threads);
            try_deformation(2, 0, threads);
            try_outliers(1, 300, 16, threads);
            try_outliers(3, 16, 15, threads);
            try_outliers(2, 2, 1, threads);
        }
    }
    std::printf("%d failures\n", failures);
    return failures != 0;
}
