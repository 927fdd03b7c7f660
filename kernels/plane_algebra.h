// Pairs (x, z) and 2 x 2 matrices of doubles, or of vectors of doubles.
#pragma once

#include "side_by_side.h"

namespace fingerflow {
namespace FINGERFLOW_ISA {
namespace {

template <class T>
struct Pair {
    T x, z;
};
// [[xx, xz], [xz, zz]]
template <class T>
struct Symmetric {
    T xx, xz, zz;
};
// [[xx, xz], [zx, zz]]
template <class T>
struct Block {
    T xx, xz, zx, zz;
};
template <class T>
inline Pair<T> operator+(Pair<T> a, Pair<T> b) { return {a.x + b.x, a.z + b.z}; }
template <class T>
inline Pair<T> operator-(Pair<T> a, Pair<T> b) { return {a.x - b.x, a.z - b.z}; }
template <class T>
inline Pair<T> operator*(T a, Pair<T> b) { return {a * b.x, a * b.z}; }
template <class T>
inline Pair<T> operator*(Block<T> a, Pair<T> b) { return {a.xx * b.x + a.xz * b.z, a.zx * b.x + a.zz * b.z}; }
template <class T>
inline Block<T> operator*(Block<T> a, Block<T> b) {
    return {a.xx * b.xx + a.xz * b.zx, a.xx * b.xz + a.xz * b.zz, a.zx * b.xx + a.zz * b.zx, a.zx * b.xz + a.zz * b.zz};
}
template <class T>
inline Block<T> operator-(Block<T> a, Block<T> b) { return {a.xx - b.xx, a.xz - b.xz, a.zx - b.zx, a.zz - b.zz}; }
template <class T>
inline Block<T> operator+(Block<T> a, Block<T> b) { return {a.xx + b.xx, a.xz + b.xz, a.zx + b.zx, a.zz + b.zz}; }
template <class T>
inline Block<T> operator*(T a, Block<T> b) { return {a * b.xx, a * b.xz, a * b.zx, a * b.zz}; }
template <class T>
inline Block<T> scaled(T by, Symmetric<T> a) { return {by * a.xx, by * a.xz, by * a.xz, by * a.zz}; }
template <class T>
inline Block<T> inverse(Block<T> a) {
    const T one = 1.0 / (a.xx * a.zz - a.xz * a.zx);
    return {one * a.zz, -(one * a.xz), -(one * a.zx), one * a.xx};
}
template <class T>
inline T farthest(T most, Pair<T> of) { return greater(most, greater(magnitude(of.x), magnitude(of.z))); }

}  // namespace
}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
