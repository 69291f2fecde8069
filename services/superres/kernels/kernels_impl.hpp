// The kernels, compiled once for each instruction set: included by kernels_*.cpp inside an unnamed namespace, after
// they have defined
//   kLanes, Vec      floats in a vector, and its type
// Nothing of the standard library is used here: its inline functions would be compiled for the larger instruction set
// and might replace those of the rest of the program.

constexpr int kMost = kLanes == 16 ? 12 : 6;  // rows whose sums stay in registers

inline Vec broadcast(float value) { return Vec{} + value; }
inline Vec load(const float* p) { return *reinterpret_cast<const Vec*>(p); }
inline void store(float* p, Vec v) { *reinterpret_cast<Vec*>(p) = v; }

/// A matrix product whose sums stay in registers: c (rows, N kLanes) = sum over the steps of a (rows, kGroup) times
/// b (kGroup, N kLanes). Strides in elements; those of b and c are multiples of kLanes.
template <class Element>
struct Product {
  const Element* a;
  long a_row, a_step;
  const Element* b;
  long b_step;
  int steps;
  float* c;
  long c_row;
};

template <class Type, int N, int M = kMost>
void multiply_rows(int rows, const Product<typename Type::Element>& p) {
  if (rows < M) {
    if constexpr (M > 1) multiply_rows<Type, N, M - 1>(rows, p);
    return;
  }
  Vec sums[M][N] = {};
  for (int i = 0; i < p.steps; ++i) {
    typename Type::Factors w[N];
#pragma GCC unroll 4
    for (int n = 0; n < N; ++n) w[n] = Type::factors(p.b + i * p.b_step + n * kLanes * Type::kGroup);
#pragma GCC unroll 12
    for (int m = 0; m < M; ++m) {
      const auto x = Type::factor(p.a + m * p.a_row + i * p.a_step);
#pragma GCC unroll 4
      for (int n = 0; n < N; ++n) sums[m][n] = Type::add_products(sums[m][n], x, w[n]);
    }
  }
#pragma GCC unroll 12
  for (int m = 0; m < M; ++m) {
#pragma GCC unroll 4
    for (int n = 0; n < N; ++n) store(p.c + m * p.c_row + n * kLanes, sums[m][n]);
  }
}

/// Features in float32.
struct Float32 {
  using Element = float;
  static constexpr int kGroup = 1;
  static Vec read(const float* p) { return load(p); }
  static void write(float* p, Vec v) { store(p, v); }

  /// kGroup factors for each lane: those at p, or the same for all.
  using Factors = Vec;
  static Factors factors(const float* p) { return load(p); }
  static Factors factor(const float* p) { return broadcast(*p); }
  static Vec add_products(Vec sum, Factors x, Factors w) { return sum + x * w; }

  /// One group: its only member.
  static void write_group(float* p, const Vec* v) { store(p, v[0]); }

  /// Weights of one point in packed order: row i, column block of `width`.
  static void write_weights(float* block, int i, int width, int column, Vec v) { store(block + i * width + column, v); }

  static constexpr int kRows = kMost;
  static void begin_products(int) {}
  static void end_products() {}
  template <int N>
  static void multiply(int rows, const Product<Element>& p) {
    multiply_rows<Float32, N>(rows, p);
  }
};

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
  if (call.mask != nullptr) {
    const auto* mask = static_cast<const typename Type::Element*>(call.mask) + pixel * call.mask_stride + channel;
    value = Type::read(mask) > Vec{} ? value : Vec{};
  }
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
    Type::template multiply<N>(
        rows,
        {input + p * points, tiles, Type::kGroup, weights + static_cast<long>(p) * call.k * call.n,
         kWidth * Type::kGroup, call.k / Type::kGroup, call.scratch + static_cast<long>(p) * rows * kWidth, kWidth});
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
  const int blocks = (count + Type::kRows - 1) / Type::kRows;
  for (int b = 0; b < blocks; ++b) {
    const int tile = static_cast<int>(static_cast<long>(count) * b / blocks);
    const int rows = static_cast<int>(static_cast<long>(count) * (b + 1) / blocks) - tile;
    Type::begin_products(rows);
    int n = 0;
    for (; n + 2 * kLanes <= call.n; n += 2 * kLanes) convolve3_block<Type, 2>(g, call, first + tile, rows, n);
    if (n < call.n) convolve3_block<Type, 1>(g, call, first + tile, rows, n);
  }
  Type::end_products();
}

template <class Type>
void convolve1(const Geometry& g, const ConvolutionCall& call, int begin, int end) {
  using Element = typename Type::Element;
  const int last = end * kTile < g.height ? end * kTile : g.height;
  const int blocks = (g.width + Type::kRows - 1) / Type::kRows;
  const Element* weights = static_cast<const Element*>(call.weights);
  for (int y = begin * kTile; y < last; ++y) {
    for (int b = 0; b < blocks; ++b) {
      const int x = g.width * b / blocks, rows = g.width * (b + 1) / blocks - x;
      const long pixel = static_cast<long>(y + 1) * g.row + x + 1;
      const Element* input = static_cast<const Element*>(call.input) + pixel * call.input_stride;
      // All sums before the first output, which may lie in the input.
      const auto product = [&](int n, int width) -> Product<Element> {
        return {input,
                call.input_stride,
                Type::kGroup,
                weights + static_cast<long>(n) * call.k,
                width * Type::kGroup,
                call.k / Type::kGroup,
                call.scratch + n * rows,
                width};
      };
      Type::begin_products(rows);
      int n = 0;
      for (; n + 2 * kLanes <= call.n; n += 2 * kLanes) Type::template multiply<2>(rows, product(n, 2 * kLanes));
      if (n < call.n) Type::template multiply<1>(rows, product(n, kLanes));
      for (n = 0; n < call.n; n += kLanes) {
        // A block has two vectors a row, but for a last one alone.
        const int width = (n / kLanes) % 2 == 0 && n + kLanes == call.n ? kLanes : 2 * kLanes;
        const float* sums = call.scratch + n / (2 * kLanes) * (2 * kLanes) * rows + n % (2 * kLanes);
        for (int m = 0; m < rows; ++m) finish<Type>(call, pixel + m, n, load(sums + m * width));
      }
    }
  }
  Type::end_products();
}

template <class Type>
void store_elements(const float* values, void* elements, int count) {
  for (int i = 0; i < count; i += kLanes)
    Type::write(static_cast<typename Type::Element*>(elements) + i, load(values + i));
}

template <class Type>
void store_masked(const float* values, const void* mask, void* elements, int count) {
  using Element = typename Type::Element;
  for (int i = 0; i < count; i += kLanes) {
    const Vec value = load(values + i);
    const Vec sign = Type::read(static_cast<const Element*>(mask) + i);
    Type::write(static_cast<Element*>(elements) + i, sign > Vec{} ? value : Vec{});
  }
}

/// One dimension of a kernel's transform: 3 weights to 6 points.
inline void transform_weights(Vec a, Vec b, Vec c, Vec* result) {
  const Vec even = (a + c) * (-1.0f / 6), odd = b * (1.0f / 6);
  const Vec far_even = a * (1.0f / 24) + c * (1.0f / 6), far_odd = b * (1.0f / 12);
  result[0] = a * 0.25f;
  result[1] = even - odd;
  result[2] = even + odd;
  result[3] = far_even + far_odd;
  result[4] = far_even - far_odd;
  result[5] = c;
}

template <class Type>
void pack3(const float* taps, int k, int n, void* weights) {
  using Element = typename Type::Element;
  constexpr int kBlock = 2 * kLanes;
  const long plane = static_cast<long>(k) * n;
  for (int i = 0; i < k; ++i) {
    for (int j = 0; j < n; j += kLanes) {
      Vec rows[3][6], points[6];
      for (int y = 0; y < 3; ++y) {
        const float* row = taps + 3 * y * plane + static_cast<long>(i) * n + j;
        transform_weights(load(row), load(row + plane), load(row + 2 * plane), rows[y]);
      }
      const int first = j / kBlock * kBlock, width = n - first < kBlock ? n - first : kBlock;
      for (int x = 0; x < 6; ++x) {
        transform_weights(rows[0][x], rows[1][x], rows[2][x], points);
        for (int y = 0; y < 6; ++y) {
          Type::write_weights(static_cast<Element*>(weights) + (6 * y + x) * plane + static_cast<long>(first) * k, i,
                              width, j - first, points[y]);
        }
      }
    }
  }
}

/// Writes tiles in groups: transform(tile's row, its column, first channel, result) gives the points of one.
template <class Type, class Transform>
void group_tiles(const Geometry& g, const GroupCall& call, const Transform& transform) {
  using Element = typename Type::Element;
  const int tiles = g.tiles_y * g.tiles_x;
  for (int tile = 0; tile < tiles; tile += Type::kGroup) {
    Element* target = static_cast<Element*>(call.groups) +
                      (static_cast<long>(tile / Type::kGroup) * call.stride + call.target) * Type::kGroup;
    for (int channel = 0; channel < call.channels; channel += kLanes) {
      Vec t[Type::kGroup][6][6] = {};
      for (int s = 0; s < Type::kGroup && tile + s < tiles; ++s) {
        transform((tile + s) / g.tiles_x, (tile + s) % g.tiles_x, call.first + channel, t[s]);
      }
      for (int p = 0; p < kPoints; ++p) {
        Vec members[Type::kGroup];
        for (int s = 0; s < Type::kGroup; ++s) members[s] = t[s][p / 6][p % 6];
        Type::write_group(target + p * call.plane + channel * Type::kGroup, members);
      }
    }
  }
}

template <class Type>
void group_inputs(const Geometry& g, const GroupCall& call) {
  using Element = typename Type::Element;
  const long stride = call.image_stride, row = g.row * stride;
  group_tiles<Type>(g, call, [&](int ty, int tx, int channel, Vec(&t)[6][6]) {
    const Element* image = static_cast<const Element*>(call.image) + (ty * row + tx * stride) * kTile + channel;
#pragma GCC unroll 6
    for (int x = 0; x < 6; ++x) {
#pragma GCC unroll 6
      for (int y = 0; y < 6; ++y) t[y][x] = Type::read(image + y * row + x * stride);
      transform6(t[0][x], t[1][x], t[2][x], t[3][x], t[4][x], t[5][x]);
    }
#pragma GCC unroll 6
    for (int y = 0; y < 6; ++y) transform6(t[y][0], t[y][1], t[y][2], t[y][3], t[y][4], t[y][5]);
  });
}

/// Transpose of gather4: 4 pixels to 6 points.
inline void scatter4(Vec a, Vec b, Vec c, Vec d, Vec* result) {
  const Vec even = a + c, odd = b + d, far_even = a + 4.0f * c, far_odd = 2.0f * b + 8.0f * d;
  result[0] = a;
  result[1] = even + odd;
  result[2] = even - odd;
  result[3] = far_even + far_odd;
  result[4] = far_even - far_odd;
  result[5] = d;
}

template <class Type>
void group_outputs(const Geometry& g, const GroupCall& call) {
  using Element = typename Type::Element;
  const long stride = call.image_stride, row = g.row * stride;
  group_tiles<Type>(g, call, [&](int ty, int tx, int channel, Vec(&t)[6][6]) {
    // Pixels beyond the image are zero, as its border is.
    const Element* image = static_cast<const Element*>(call.image) + (static_cast<long>(ty) * kTile + 1) * row +
                           (tx * kTile + 1) * stride + channel;
    Vec columns[4][6];
#pragma GCC unroll 4
    for (int x = 0; x < 4; ++x) {
      scatter4(Type::read(image + x * stride), Type::read(image + row + x * stride),
               Type::read(image + 2 * row + x * stride), Type::read(image + 3 * row + x * stride), columns[x]);
    }
#pragma GCC unroll 6
    for (int y = 0; y < 6; ++y) scatter4(columns[0][y], columns[1][y], columns[2][y], columns[3][y], t[y]);
  });
}

template <class Type>
void group_pixels(const Geometry& g, const GroupCall& call) {
  using Element = typename Type::Element;
  const int pixels = g.height * g.width;
  for (int pixel = 0; pixel < pixels; pixel += Type::kGroup) {
    Element* target = static_cast<Element*>(call.groups) +
                      (static_cast<long>(pixel / Type::kGroup) * call.stride + call.target) * Type::kGroup;
    for (int channel = 0; channel < call.channels; channel += kLanes) {
      Vec members[Type::kGroup] = {};
      for (int s = 0; s < Type::kGroup && pixel + s < pixels; ++s) {
        const int y = (pixel + s) / g.width, x = (pixel + s) % g.width;
        members[s] = Type::read(static_cast<const Element*>(call.image) +
                                (static_cast<long>(y + 1) * g.row + x + 1) * call.image_stride + call.first + channel);
      }
      Type::write_group(target + channel * Type::kGroup, members);
    }
  }
}

template <class Type>
void correlate(const CorrelateCall& call) {
  using Element = typename Type::Element;
  constexpr int kGroup = Type::kGroup;
  const long a_stride = static_cast<long>(call.a_stride) * kGroup, b_stride = static_cast<long>(call.b_stride) * kGroup;
  const int blocks = (call.k + kMost - 1) / kMost;
  for (int p = 0; p < call.points; ++p) {
    const Element* a = static_cast<const Element*>(call.a) + p * call.a_plane;
    const Element* b = static_cast<const Element*>(call.b) + p * call.b_plane;
    float* sums = call.sums + static_cast<long>(p) * call.k * call.n;
    for (int block = 0; block < blocks; ++block) {
      const int i = call.k * block / blocks, rows = call.k * (block + 1) / blocks - i;
      const auto product = [&](int j) -> Product<Element> {
        return {a + i * kGroup,
                kGroup,
                a_stride,
                b + j * kGroup,
                b_stride,
                call.groups,
                sums + static_cast<long>(i) * call.n + j,
                call.n};
      };
      int j = 0;
      for (; j + 2 * kLanes <= call.n; j += 2 * kLanes) multiply_rows<Type, 2>(rows, product(j));
      if (j < call.n) multiply_rows<Type, 1>(rows, product(j));
    }
  }
}

/// Transpose of transform_weights: 6 points to 3 weights.
inline void gather_weights(const Vec* p, Vec* result) {
  const Vec near_sum = p[1] + p[2], near_difference = p[2] - p[1], far_sum = p[3] + p[4], far_difference = p[3] - p[4];
  result[0] = 0.25f * p[0] - (1.0f / 6) * near_sum + (1.0f / 24) * far_sum;
  result[1] = (1.0f / 6) * near_difference + (1.0f / 12) * far_difference;
  result[2] = (1.0f / 6) * (far_sum - near_sum) + p[5];
}

inline void add_taps(const float* sums, int k, int n, float* taps) {
  const long plane = static_cast<long>(k) * n;
  for (long at = 0; at < plane; at += kLanes) {
    Vec rows[6][3], column[6], weights[3];
    for (int y = 0; y < 6; ++y) {
      Vec points[6];
      for (int x = 0; x < 6; ++x) points[x] = load(sums + (6 * y + x) * plane + at);
      gather_weights(points, rows[y]);
    }
    for (int x = 0; x < 3; ++x) {
      for (int y = 0; y < 6; ++y) column[y] = rows[y][x];
      gather_weights(column, weights);
      for (int y = 0; y < 3; ++y) {
        float* place = taps + (3 * y + x) * plane + at;
        store(place, load(place) + weights[y]);
      }
    }
  }
}

/// The table of one element type.
template <class Type>
constexpr Kernels make_kernels(const char* name) {
  return {name,
          kLanes,
          sizeof(typename Type::Element),
          2 * kLanes,
          Type::kGroup,
          transform<Type>,
          convolve3<Type>,
          convolve1<Type>,
          store_elements<Type>,
          store_masked<Type>,
          pack3<Type>,
          group_inputs<Type>,
          group_outputs<Type>,
          group_pixels<Type>,
          correlate<Type>,
          add_taps};
}
