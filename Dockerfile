# CPU:   docker build -t fishrl . && docker run --rm -v "$PWD/demo:/fishrl/demo" fishrl
# CUDA:  docker build -t fishrl --build-arg TORCH_BACKEND=cu130 . && docker run --rm --gpus all fishrl ...
ARG PYTHON=3.13
FROM python:${PYTHON}-slim

# torch.compile compiles the flow step with a C++ compiler
RUN apt-get update && apt-get install -y --no-install-recommends g++ git make \
    && rm -rf /var/lib/apt/lists/*
RUN pip install --no-cache-dir uv

# which build of torch: cpu, or a version of CUDA such as cu130
ARG TORCH_BACKEND=cpu
WORKDIR /fishrl
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY fishrl fishrl
COPY experiments experiments
RUN uv pip install --system --no-cache --torch-backend=${TORCH_BACKEND} -c constraints.txt -e .

CMD ["fishrl", "demo"]
