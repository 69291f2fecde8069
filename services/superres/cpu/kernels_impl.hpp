// The kernels, compiled once for each instruction set: included by kernels_*.cpp inside an unnamed namespace, after
// they have defined
//   kLanes, Vec      floats in a vector, and its type
// Nothing of the standard library is used here: its inline functions would be compiled for the larger instruction set
// and might replace those of the rest of the program.

constexpr int kMost = kLanes == 16 ? 12 : 6;  // rows whose sums stay in registers

inline Vec broadcast(float value) { return Vec{} + value; }
inline Vec load(const float* p) { return *reinterpret_cast<const Vec*>(p); }
inline void store(float* p, Vec v) { *reinterpret_cast<Vec*>(p) = v; }

/// Features in float32.
struct Float32 {
  using Element = float;
  static Vec read(const float* p) { return load(p); }
  static void write(float* p, Vec v) { store(p, v); }

  /// c (M x N kLanes) = a (M x k) b (k x N kLanes).
  template <int M, int N>
  static void multiply(const float* a, long a_stride, const float* b, int k, float* c) {
    Vec sums[M][N] = {};
    for (int i = 0; i < k; ++i) {
      Vec w[N];
#pragma GCC unroll 4
      for (int n = 0; n < N; ++n) w[n] = load(b + (i * N + n) * kLanes);
#pragma GCC unroll 12
      for (int m = 0; m < M; ++m) {
        const Vec x = broadcast(a[m * a_stride + i]);
#pragma GCC unroll 4
        for (int n = 0; n < N; ++n) sums[m][n] += x * w[n];
      }
    }
#pragma GCC unroll 12
    for (int m = 0; m < M; ++m) {
#pragma GCC unroll 4
      for (int n = 0; n < N; ++n) store(c + (m * N + n) * kLanes, sums[m][n]);
    }
  }
};

template <class Type, int N, int M = kMost>
void multiply_rows(int rows, const typename Type::Element* a, long a_stride, const typename Type::Element* b, int k,
                   float* c) {
  if (rows == M) {
    Type::template multiply<M, N>(a, a_stride, b, k, c);
  } else if constexpr (M > 1) {
    multiply_rows<Type, N, M - 1>(rows, a, a_stride, b, k, c);
  }
}

/// One dimension of the input transform: 6 pixels to 6 points (0, 1, -1, 2, -2, infinity).
inline void transform6(Vec& a, Vec& b, Vec& c, Vec& d, Vec& e, Vec& f) {
  const Vec p = e - 4.0f * c, q = d - 4.0f * b, r = e - c, s = 2.0f * (d - b);
  const Vec first = 4.0f * a - 5.0f * c + e, last = 4.0f * b - 5.0f * d + f;
  a = first;
  b = p + q;
  c = p - q;
  d = r + s;
  e = r - s;
  f = last;
}

/// One dimension of the output transform: 6 points to 4 pixels, in a..d.
inline void gather4(Vec& a, Vec& b, Vec& c, Vec& d, Vec e, Vec f) {
  const Vec p = b + c, q = b - c, r = d + e, s = d - e;
  a = a + p + r;
  b = q + 2.0f * s;
  c = p + 4.0f * r;
  d = q + 8.0f * s + f;
}

template <class Type>
void transform(const Geometry& g, const TransformCall& call, int begin, int end) {
  using Element = typename Type::Element;
  const long stride = call.image_stride, row = g.row * stride, points = call.transformed_stride;
  for (int ty = begin; ty < end; ++ty) {
    for (int tx = 0; tx < g.tiles_x; ++tx) {
      const Element* image = static_cast<const Element*>(call.image) + (ty * row + tx * stride) * kTile + call.first;
      Element* target = static_cast<Element*>(call.transformed) +
                        (static_cast<long>(ty - call.origin) * g.tiles_x + tx) * kPoints * points + call.target;
      for (int channel = 0; channel < call.channels; channel += kLanes) {
        Vec t[6][6];
#pragma GCC unroll 6
        for (int x = 0; x < 6; ++x) {
#pragma GCC unroll 6
          for (int y = 0; y < 6; ++y) t[y][x] = Type::read(image + y * row + x * stride + channel);
          transform6(t[0][x], t[1][x], t[2][x], t[3][x], t[4][x], t[5][x]);
        }
#pragma GCC unroll 6
        for (int y = 0; y < 6; ++y) {
          transform6(t[y][0], t[y][1], t[y][2], t[y][3], t[y][4], t[y][5]);
#pragma GCC unroll 6
          for (int x = 0; x < 6; ++x) Type::write(target + (6 * y + x) * points + channel, t[y][x]);
        }
      }
    }
  }
}

template <class Type>
inline void finish(const ConvolutionCall& call, long pixel, int channel, Vec value) {
  value += load(call.bias + channel);
  if (call.add != nullptr) value += load(call.add + pixel * call.add_stride + channel);
  if (call.slope != nullptr) value = value > Vec{} ? value : value * load(call.slope + channel);
  if (call.output != nullptr) store(call.output + pixel * call.output_stride + channel, value);
  if (call.stored != nullptr) {
    Type::write(static_cast<typename Type::Element*>(call.stored) + pixel * call.stored_stride + channel, value);
  }
  if (call.also_stored != nullptr) {
    Type::write(static_cast<typename Type::Element*>(call.also_stored) + pixel * call.also_stored_stride + channel,
                value);
  }
}

/// Sums of one tile, `points` floats apart, to its pixels.
template <class Type>
void finish_tile(const Geometry& g, const ConvolutionCall& call, int tile, int channel, const float* sums,
                 long points) {
  Vec t[6][6];
#pragma GCC unroll 6
  for (int x = 0; x < 6; ++x) {
#pragma GCC unroll 6
    for (int y = 0; y < 6; ++y) t[y][x] = load(sums + (6 * y + x) * points);
    gather4(t[0][x], t[1][x], t[2][x], t[3][x], t[4][x], t[5][x]);
  }
  const int top = tile / g.tiles_x * kTile, left = tile % g.tiles_x * kTile;
  const int rows = g.height - top < kTile ? g.height - top : kTile;
  const int columns = g.width - left < kTile ? g.width - left : kTile;
  if (rows == kTile && columns == kTile) {
#pragma GCC unroll 4
    for (int y = 0; y < kTile; ++y) {
      gather4(t[y][0], t[y][1], t[y][2], t[y][3], t[y][4], t[y][5]);
      const long pixel = static_cast<long>(top + y + 1) * g.row + left + 1;
#pragma GCC unroll 4
      for (int x = 0; x < kTile; ++x) finish<Type>(call, pixel + x, channel, t[y][x]);
    }
    return;
  }
  for (int y = 0; y < rows; ++y) {
    gather4(t[y][0], t[y][1], t[y][2], t[y][3], t[y][4], t[y][5]);
    const long pixel = static_cast<long>(top + y + 1) * g.row + left + 1;
    for (int x = 0; x < columns; ++x) finish<Type>(call, pixel + x, channel, t[y][x]);
  }
}

template <class Type, int N>
void convolve3_block(const Geometry& g, const ConvolutionCall& call, int tile, int rows, int first) {
  using Element = typename Type::Element;
  constexpr int kWidth = N * kLanes;
  const long points = call.input_stride, tiles = kPoints * points;
  const Element* input = static_cast<const Element*>(call.input) + (tile - call.origin * g.tiles_x) * tiles;
  const Element* weights = static_cast<const Element*>(call.weights) + static_cast<long>(first) * call.k;
  for (int p = 0; p < kPoints; ++p) {
    multiply_rows<Type, N>(rows, input + p * points, tiles, weights + static_cast<long>(p) * call.k * call.n, call.k,
                           call.scratch + static_cast<long>(p) * rows * kWidth);
  }
  for (int m = 0; m < rows; ++m) {
    for (int n = 0; n < N; ++n) {
      finish_tile<Type>(g, call, tile + m, first + n * kLanes, call.scratch + m * kWidth + n * kLanes, rows * kWidth);
    }
  }
}

template <class Type>
void convolve3(const Geometry& g, const ConvolutionCall& call, int begin, int end) {
  const int first = begin * g.tiles_x, count = (end - begin) * g.tiles_x;
  const int blocks = (count + kMost - 1) / kMost;
  for (int b = 0; b < blocks; ++b) {
    const int tile = static_cast<int>(static_cast<long>(count) * b / blocks);
    const int rows = static_cast<int>(static_cast<long>(count) * (b + 1) / blocks) - tile;
    int n = 0;
    for (; n + 2 * kLanes <= call.n; n += 2 * kLanes) convolve3_block<Type, 2>(g, call, first + tile, rows, n);
    if (n < call.n) convolve3_block<Type, 1>(g, call, first + tile, rows, n);
  }
}

template <class Type>
void convolve1(const Geometry& g, const ConvolutionCall& call, int begin, int end) {
  using Element = typename Type::Element;
  const int last = end * kTile < g.height ? end * kTile : g.height;
  const int blocks = (g.width + kMost - 1) / kMost;
  const Element* weights = static_cast<const Element*>(call.weights);
  for (int y = begin * kTile; y < last; ++y) {
    for (int b = 0; b < blocks; ++b) {
      const int x = g.width * b / blocks, rows = g.width * (b + 1) / blocks - x;
      const long pixel = static_cast<long>(y + 1) * g.row + x + 1;
      const Element* input = static_cast<const Element*>(call.input) + pixel * call.input_stride;
      // All sums before the first output, which may lie in the input.
      int n = 0;
      for (; n + 2 * kLanes <= call.n; n += 2 * kLanes) {
        multiply_rows<Type, 2>(rows, input, call.input_stride, weights + static_cast<long>(n) * call.k, call.k,
                               call.scratch + n * rows);
      }
      if (n < call.n) {
        multiply_rows<Type, 1>(rows, input, call.input_stride, weights + static_cast<long>(n) * call.k, call.k,
                               call.scratch + n * rows);
      }
      for (n = 0; n < call.n; n += kLanes) {
        // A block has two vectors a row, but for a last one alone.
        const int width = (n / kLanes) % 2 == 0 && n + kLanes == call.n ? kLanes : 2 * kLanes;
        const float* sums = call.scratch + n / (2 * kLanes) * (2 * kLanes) * rows + n % (2 * kLanes);
        for (int m = 0; m < rows; ++m) finish<Type>(call, pixel + m, n, load(sums + m * width));
      }
    }
  }
}

template <class Type>
void store_elements(const float* values, void* elements, int count) {
  for (int i = 0; i < count; i += kLanes)
    Type::write(static_cast<typename Type::Element*>(elements) + i, load(values + i));
}
