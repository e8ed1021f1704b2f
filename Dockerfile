# The CPU build of torch, the package with the versions its figures were made with, and the small benchmark:
#     docker build -t cp-env . && docker run --rm cp-env
# Results stay with:   docker run --rm -v "$PWD/out:/cp-env/out" cp-env
FROM python:3.11-slim
RUN apt-get update && apt-get install --yes --no-install-recommends make && rm -rf /var/lib/apt/lists/*
WORKDIR /cp-env
ENV PIP_NO_CACHE_DIR=1
# What is installed changes seldom: these layers are kept when the code changes.
COPY Makefile constraints.txt pyproject.toml PACKAGE.md LICENSE ./
COPY cp_env cp_env
COPY defenders defenders
COPY agents agents
RUN make .venv/.installed
COPY . .
ENV PATH=/cp-env/.venv/bin:$PATH OMP_NUM_THREADS=1
CMD ["make", "demo"]
