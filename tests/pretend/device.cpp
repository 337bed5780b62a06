// Tensors of device cuda:0 in host memory, whose operators are those of the CPU: for tests of code
// that is meant for a GPU, on machines without one.
//
// Every operator that reaches the dispatch key CUDA runs here on CPU tensors that share memory with
// its arguments (nothing is copied), after the checks that CUDA kernels make: all tensors on one
// device, but for numbers without dimensions and indices. What it returns lives on cuda:0 again.
// Fresh memory is filled with NaN, as on a GPU nobody clears it. Needs a torch built without CUDA.

#include <ATen/ATen.h>
#include <ATen/CPUGeneratorImpl.h>
#include <ATen/EmptyTensor.h>
#include <ATen/core/dispatch/Dispatcher.h>
#include <ATen/detail/CUDAHooksInterface.h>
#include <c10/core/impl/DeviceGuardImplInterface.h>
#include <torch/library.h>

#include <cstdlib>
#include <cstring>
#include <string>
#include <unordered_map>
#include <unordered_set>

namespace {

const c10::Device kGpu(c10::kCUDA, 0);
constexpr c10::DispatchKeySet kKeys{c10::DispatchKey::CUDA};

// ---------------------------------------------------------------------------------------- memory

void release(void* p) { std::free(p); }

struct Memory final : c10::Allocator {
  c10::DataPtr allocate(size_t n) override {
    void* p = n ? std::aligned_alloc(512, (n + 511) / 512 * 512) : nullptr;
    if (n) std::memset(p, 0xFF, n);  // NaN in every floating-point type
    return {p, p, &release, kGpu};
  }
  c10::DeleterFnPtr raw_deleter() const override { return &release; }
  void copy_data(void* to, const void* from, size_t n) const override { std::memcpy(to, from, n); }
};

Memory memory;

void drop(void* owner) { delete static_cast<c10::Storage*>(owner); }

// The same bytes under another device's name; `from` stays alive as long as the result does.
c10::Storage rename(const c10::Storage& from, c10::Device device) {
  auto* bytes = const_cast<void*>(from.data());
  return c10::Storage(
      c10::Storage::use_byte_size_t(), from.nbytes(),
      c10::DataPtr(bytes, new c10::Storage(from), &drop, device),
      device.is_cuda() ? static_cast<c10::Allocator*>(&memory) : c10::GetAllocator(c10::kCPU),
      /*resizable=*/true);
}

at::Tensor lay_out(const at::Tensor& like, const c10::Storage& storage, c10::DispatchKeySet keys) {
  auto result = at::detail::make_tensor<c10::TensorImpl>(
      c10::Storage(storage), keys, like.dtype());
  result.unsafeGetTensorImpl()->set_sizes_and_strides(
      like.sizes(), like.strides(), like.storage_offset());
  return result;
}

// ------------------------------------------------------------------------------------ generators

struct Dice final : c10::GeneratorImpl {
  explicit Dice(at::Generator twin = at::detail::createCPUGenerator())
      : GeneratorImpl(kGpu, kKeys), host(std::move(twin)) {}
  void set_current_seed(uint64_t seed) override { host.set_current_seed(seed); }
  void set_offset(uint64_t) override {}
  uint64_t get_offset() const override { return 0; }
  uint64_t current_seed() const override { return host.current_seed(); }
  uint64_t seed() override { return host.seed(); }
  void set_state(const c10::TensorImpl& state) override {
    host.unsafeGetGeneratorImpl()->set_state(state);
  }
  c10::intrusive_ptr<c10::TensorImpl> get_state() const override {
    return host.unsafeGetGeneratorImpl()->get_state();
  }
  Dice* clone_impl() const override { return new Dice(host.clone()); }
  at::Generator host;
};

// ----------------------------------------------------------------------------------- the fallback

bool is_gpu(const at::Tensor& t) { return t.defined() && t.device().is_cuda(); }

// Operators that take indices or masks from the host too.
const std::unordered_set<std::string> kTakesHostIndices{
    "aten::index", "aten::_unsafe_index", "aten::index_put_", "aten::_index_put_impl_",
    "aten::index_put", "aten::_unsafe_index_put", "aten::copy_"};
// Operators that take nothing from the host, numbers without dimensions neither.
const std::unordered_set<std::string> kStrict{
    "aten::cat", "aten::gather", "aten::scatter", "aten::scatter_", "aten::scatter_add",
    "aten::scatter_add_", "aten::index_select", "aten::mm", "aten::bmm", "aten::addmm",
    "aten::baddbmm", "aten::embedding", "aten::scatter_reduce", "aten::searchsorted"};

class Call {
 public:
  Call(const c10::OperatorHandle& op, torch::jit::Stack* stack)
      : op_(op), stack_(*stack), first_(stack->size() - op.schema().arguments().size()) {}

  void run() {
    check();
    for (size_t i = first_; i < stack_.size(); ++i) to_host(stack_[i]);
    op_.redispatchBoxed(c10::DispatchKeySet(c10::DispatchKey::CPU), &stack_);
    for (auto& [host, device] : pairs_) follow_resize(host, device);
    const auto num = op_.schema().returns().size();
    for (size_t i = stack_.size() - num; i < stack_.size(); ++i) to_device(stack_[i]);
  }

 private:
  template <class Visit>
  void each_tensor(const c10::IValue& value, Visit visit) {
    if (value.isTensor()) {
      visit(value.toTensor());
    } else if (value.isTensorList()) {
      for (const auto& t : value.toTensorVector()) visit(t);
    } else if (value.isOptionalTensorList()) {
      for (const auto& t : value.toOptionalTensorVector()) if (t) visit(*t);
    }
  }

  void check() {
    const auto& schema = op_.schema();
    const auto& name = schema.name();
    for (size_t i = first_; i < stack_.size(); ++i) {
      const auto& argument = schema.arguments()[i - first_];
      const bool is_written = argument.alias_info() && argument.alias_info()->isWrite();
      each_tensor(stack_[i], [&](const at::Tensor& t) {
        if (!t.defined() || t.device().is_cuda()) return;
        const bool is_number = t.dim() == 0 && !is_written && !kStrict.count(name);
        const bool is_index = argument.name() == "indices" && kTakesHostIndices.count(name);
        TORCH_CHECK(
            is_number || is_index,
            "Expected all tensors to be on the same device, but found at least two devices, "
            "cuda:0 and ", t.device(), "! (argument '", argument.name(), "' of ", name,
            ", shape ", t.sizes(), ")");
      });
    }
  }

  at::Tensor to_host(const at::Tensor& t) {
    if (!is_gpu(t)) return t;
    for (auto& [host, device] : pairs_) if (device.is_same(t)) return host;
    auto* key = t.storage().unsafeGetStorageImpl();
    auto found = storages_.find(key);
    if (found == storages_.end())
      found = storages_.emplace(key, rename(t.storage(), c10::Device(c10::kCPU))).first;
    auto host = lay_out(t, found->second, c10::DispatchKeySet(c10::DispatchKey::CPU));
    if (t.unsafeGetTensorImpl()->is_wrapped_number())
      host.unsafeGetTensorImpl()->set_wrapped_number(true);
    pairs_.emplace_back(host, t);
    return host;
  }

  void to_host(c10::IValue& value) {
    if (value.isTensor()) {
      value = to_host(value.toTensor());
    } else if (value.isTensorList()) {
      std::vector<at::Tensor> all;
      for (const auto& t : value.toTensorVector()) all.push_back(to_host(t));
      value = c10::IValue(all);
    } else if (value.isOptionalTensorList()) {
      c10::List<std::optional<at::Tensor>> all;
      for (const auto& t : value.toOptionalTensorVector())
        all.push_back(t ? std::optional<at::Tensor>(to_host(*t)) : std::nullopt);
      value = c10::IValue(all);
    } else if (value.isDevice() && value.toDevice().is_cuda()) {
      value = c10::IValue(c10::Device(c10::kCPU));
    } else if (value.isGenerator() && value.toGenerator().defined()) {
      const auto generator = value.toGenerator();
      TORCH_CHECK(
          generator.device().is_cuda(),
          "Expected a 'cuda' device type for generator but found '", generator.device().type(), "'");
      value = static_cast<Dice*>(generator.unsafeGetGeneratorImpl())->host;
    }
  }

  at::Tensor to_device(const at::Tensor& t) {
    if (!t.defined() || !t.device().is_cpu()) return t;
    for (auto& [host, device] : pairs_) if (host.is_same(t)) return device;
    for (auto& [key, storage] : storages_) {
      if (storage.unsafeGetStorageImpl() != t.storage().unsafeGetStorageImpl()) continue;
      for (auto& [host, device] : pairs_)
        if (device.storage().unsafeGetStorageImpl() == key) return lay_out(t, device.storage(), kKeys);
    }
    return lay_out(t, rename(t.storage(), kGpu), kKeys);
  }

  void to_device(c10::IValue& value) {
    if (value.isTensor()) {
      value = to_device(value.toTensor());
    } else if (value.isTensorList()) {
      std::vector<at::Tensor> all;
      for (const auto& t : value.toTensorVector()) all.push_back(to_device(t));
      value = c10::IValue(all);
    }
  }

  // `resize_` and `out=` may have changed the shape or the memory of an argument.
  void follow_resize(const at::Tensor& host, const at::Tensor& device) {
    if (host.storage().data() != device.storage().data()) {
      auto fresh = rename(host.storage(), kGpu);
      auto* storage = device.storage().unsafeGetStorageImpl();
      storage->set_data_ptr_noswap(std::move(fresh.unsafeGetStorageImpl()->_mutable_data_ptr_no_checks()));
      storage->set_nbytes(host.storage().nbytes());
    }
    if (host.sizes() != device.sizes() || host.strides() != device.strides())
      device.unsafeGetTensorImpl()->set_sizes_and_strides(
          host.sizes(), host.strides(), host.storage_offset());
  }

  const c10::OperatorHandle& op_;
  torch::jit::Stack& stack_;
  const size_t first_;
  std::vector<std::pair<at::Tensor, at::Tensor>> pairs_;
  std::unordered_map<c10::StorageImpl*, c10::Storage> storages_;
};

void fall_back(const c10::OperatorHandle& op, c10::DispatchKeySet, torch::jit::Stack* stack) {
  Call(op, stack).run();
}

// ------------------------------------------------------------- operators that cannot fall back

at::Tensor empty(
    c10::SymIntArrayRef size, std::optional<at::ScalarType> dtype, std::optional<at::Layout>,
    std::optional<at::Device>, std::optional<bool>, std::optional<at::MemoryFormat> format) {
  return at::detail::empty_generic(
      C10_AS_INTARRAYREF_SLOW(size), &memory, kKeys, c10::dtype_or_default(dtype), format);
}

at::Tensor empty_strided(
    c10::SymIntArrayRef size, c10::SymIntArrayRef stride, std::optional<at::ScalarType> dtype,
    std::optional<at::Layout>, std::optional<at::Device>, std::optional<bool>) {
  return at::detail::empty_strided_generic(
      C10_AS_INTARRAYREF_SLOW(size), C10_AS_INTARRAYREF_SLOW(stride), &memory, kKeys,
      c10::dtype_or_default(dtype));
}

at::Tensor show_to_host(const at::Tensor& t) {
  if (!is_gpu(t)) return t;
  return lay_out(
      t, rename(t.storage(), c10::Device(c10::kCPU)), c10::DispatchKeySet(c10::DispatchKey::CPU));
}

at::Tensor& copy_(at::Tensor& self, const at::Tensor& from, bool) {
  show_to_host(self).copy_(show_to_host(from));
  return self;
}

at::Tensor& set_storage(
    at::Tensor& self, at::Storage source, c10::SymInt offset, c10::SymIntArrayRef size,
    c10::SymIntArrayRef stride) {
  TORCH_CHECK(source.device().is_cuda(), "Attempted to set the storage of a tensor on device ",
              self.device(), " to a storage on different device ", source.device());
  auto* impl = self.unsafeGetTensorImpl();
  impl->set_storage_keep_dtype(std::move(source));
  const auto sizes = C10_AS_INTARRAYREF_SLOW(size);
  if (stride.size() == size.size())
    impl->set_sizes_and_strides(sizes, C10_AS_INTARRAYREF_SLOW(stride), offset.expect_int());
  else {
    impl->set_sizes_contiguous(sizes);
    impl->set_storage_offset(offset.expect_int());
  }
  return self;
}

at::Tensor& set_whole_storage(at::Tensor& self, at::Storage source) {
  const auto num = static_cast<int64_t>(source.nbytes() / self.element_size());
  return set_storage(self, source, 0, c10::SymIntArrayRef({c10::SymInt(num)}), {});
}

at::Tensor& set_tensor(at::Tensor& self, const at::Tensor& source) {
  return set_storage(
      self, source.storage(), source.sym_storage_offset(), source.sym_sizes(), source.sym_strides());
}

void record_stream(at::Tensor&, c10::Stream) {}

TORCH_LIBRARY_IMPL(_, CUDA, m) { m.fallback(torch::CppFunction::makeFromBoxedFunction<&fall_back>()); }

TORCH_LIBRARY_IMPL(aten, CUDA, m) {
  m.impl("empty.memory_format", empty);
  m.impl("empty_strided", empty_strided);
  m.impl("copy_", copy_);
  m.impl("set_.source_Storage_storage_offset", set_storage);
  m.impl("set_.source_Storage", set_whole_storage);
  m.impl("set_.source_Tensor", set_tensor);
  m.impl("record_stream", record_stream);
}

// -------------------------------------------------------------------------- what torch asks about

struct Guard final : c10::impl::DeviceGuardImplInterface {
  c10::DeviceType type() const override { return c10::kCUDA; }
  c10::Device exchangeDevice(c10::Device) const override { return kGpu; }
  c10::Device getDevice() const override { return kGpu; }
  void setDevice(c10::Device) const override {}
  void uncheckedSetDevice(c10::Device) const noexcept override {}
  c10::Stream getStream(c10::Device) const override { return c10::Stream(c10::Stream::DEFAULT, kGpu); }
  c10::Stream getDefaultStream(c10::Device) const override { return c10::Stream(c10::Stream::DEFAULT, kGpu); }
  c10::Stream getNewStream(c10::Device, int) const override { return c10::Stream(c10::Stream::DEFAULT, kGpu); }
  c10::Stream getStreamFromGlobalPool(c10::Device, bool) const override {
    return c10::Stream(c10::Stream::DEFAULT, kGpu);
  }
  c10::Stream exchangeStream(c10::Stream s) const override { return s; }
  c10::DeviceIndex deviceCount() const noexcept override { return 1; }
  void record(void**, const c10::Stream&, const c10::DeviceIndex, const c10::EventFlag) const override {}
  void block(void*, const c10::Stream&) const override {}
  bool queryEvent(void*) const override { return true; }
  bool queryStream(const c10::Stream&) const override { return true; }
  void synchronizeStream(const c10::Stream&) const override {}
  void synchronizeEvent(void*) const override {}
  void synchronizeDevice(const c10::DeviceIndex) const override {}
};

C10_REGISTER_GUARD_IMPL(CUDA, Guard)

struct RegisterMemory {
  RegisterMemory() { c10::SetAllocator(c10::kCUDA, &memory); }
} register_memory;

}  // namespace

namespace at {

struct CUDAHooks final : CUDAHooksInterface {
  explicit CUDAHooks(CUDAHooksArgs) {}
  void init() const override {}
  bool isBuilt() const override { return true; }
  bool isAvailable() const override { return true; }
  bool hasCUDA() const override { return true; }
  bool hasPrimaryContext(DeviceIndex) const override { return true; }
  DeviceIndex deviceCount() const override { return 1; }
  int getNumGPUs() const override { return 1; }
  DeviceIndex current_device() const override { return 0; }
  DeviceIndex getCurrentDevice() const override { return 0; }
  void setCurrentDevice(DeviceIndex) const override {}
  DeviceIndex exchangeDevice(DeviceIndex) const override { return 0; }
  DeviceIndex maybeExchangeDevice(DeviceIndex) const override { return 0; }
  Device getDeviceFromPtr(void*) const override { return kGpu; }
  Allocator* getPinnedMemoryAllocator() const override { return c10::GetAllocator(c10::kCPU); }
  void deviceSynchronize(DeviceIndex) const override {}
  std::string showConfig() const override { return "pretended CUDA"; }
  const Generator& getDefaultGenerator(DeviceIndex) const override {
    static const Generator generator = make_generator<Dice>();
    return generator;
  }
  Generator getNewGenerator(DeviceIndex) const override { return make_generator<Dice>(); }
};

REGISTER_CUDA_HOOKS(CUDAHooks)

}  // namespace at
