// CUB's radix sort of pairs of u32: nvcc -O3 -arch=native cub_sort.cu -o cub_sort && ./cub_sort
// Compare with: ashsplat bench sort --elements N. Both sort 32 bits and time by the device's clock.
#include <algorithm>
#include <cstdio>
#include <cub/cub.cuh>
#include <random>
#include <vector>

#define CHECK(call)                                                    \
  do {                                                                 \
    cudaError_t error = (call);                                        \
    if (error != cudaSuccess) {                                        \
      std::fprintf(stderr, "%s: %s\n", #call, cudaGetErrorString(error)); \
      return 1;                                                        \
    }                                                                  \
  } while (0)

int main() {
  const int warm_up = 10, measured = 30;
  for (size_t n : {size_t(1) << 18, size_t(1) << 20, size_t(1) << 22, size_t(1) << 25}) {
    std::vector<unsigned> host(n);
    std::mt19937 random(1);
    for (unsigned &key : host) key = random();
    unsigned *keys, *sorted_keys, *values, *sorted_values;
    for (unsigned **buffer : {&keys, &sorted_keys, &values, &sorted_values}) CHECK(cudaMalloc(buffer, 4 * n));
    size_t bytes = 0;
    CHECK(cub::DeviceRadixSort::SortPairs(nullptr, bytes, keys, sorted_keys, values, sorted_values, int(n)));
    void *scratch;
    CHECK(cudaMalloc(&scratch, bytes));
    CHECK(cudaMemcpy(keys, host.data(), 4 * n, cudaMemcpyHostToDevice));
    cudaEvent_t begin, end;
    CHECK(cudaEventCreate(&begin));
    CHECK(cudaEventCreate(&end));
    std::vector<float> times;
    for (int i = 0; i < warm_up + measured; ++i) {
      CHECK(cudaEventRecord(begin));
      CHECK(cub::DeviceRadixSort::SortPairs(scratch, bytes, keys, sorted_keys, values, sorted_values, int(n)));
      CHECK(cudaEventRecord(end));
      CHECK(cudaEventSynchronize(end));
      float ms = 0;
      CHECK(cudaEventElapsedTime(&ms, begin, end));
      if (i >= warm_up) times.push_back(ms);
    }
    std::sort(times.begin(), times.end());
    std::printf("%zu pairs: median %.4f ms, least %.4f\n", n, times[measured / 2], times[0]);
    for (unsigned *buffer : {keys, sorted_keys, values, sorted_values}) CHECK(cudaFree(buffer));
    CHECK(cudaFree(scratch));
  }
}
