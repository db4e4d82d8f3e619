// Tabular Q-learning by the rules of `bench tabular`: a thread for each agent, its table in the shared memory of the
// block, a column for each thread so that no two threads wait for one bank. MOVES, CAP, POINTS, EPISODES and the
// numbers of learning are given as macros. Nothing of an agent is kept but its curve and how many episodes it ended.

extern "C" __global__ void train(const float* epsilons, float4* curves, int* finished, int steps, int agents) {
    extern __shared__ float tables[];
    const int agent = blockIdx.x * blockDim.x + threadIdx.x, width = blockDim.x;
    if (agent >= agents) return;
    const auto reward_of = [](int state) { return (-15.0f + 115.0f / MOVES * state) * 0.1f; };
    float* const q = tables + threadIdx.x;
    for (int state = 0; state <= MOVES; state++) {
        q[2 * state * width] = q[(2 * state + 1) * width] = reward_of(state);
    }
    float4* const curve = curves + (size_t)agent * POINTS;
    float4 sums = {0.0f, 0.0f, 0.0f, 0.0f};
    unsigned word = (agent * 2654435761u + 7u) | 1u;
    float epsilon = epsilons[agent], stay = q[0], move = q[width], total = 0.0f;
    int state = 0, length = 0, episode = 0, point = 0;
    for (int step = 0; step < steps; step++) {
        word ^= word << 13;
        word ^= word >> 17;
        word ^= word << 5;
        const bool random = (word >> 8) * 0x1p-24f < epsilon || stay == move;
        const int action = random ? word & 1 : move > stay;
        const int next = min(state + action, MOVES);
        const bool ended = next == MOVES;
        const float reward = reward_of(next) + (ended ? BONUS : 0.0f);
        const float next_stay = q[2 * next * width], next_move = q[(2 * next + 1) * width];
        const float old = action ? move : stay;
        const float target = reward + (ended ? 0.0f : DISCOUNT * fmaxf(next_stay, next_move));
        const float value = old + RATE * (target - old);
        q[(2 * state + action) * width] = value;
        length++;
        total += reward;
        if (ended || length >= CAP) {
            const int here = (int)((long long)episode * POINTS / EPISODES);
            if (here != point) {
                curve[point] = sums;
                sums = {0.0f, 0.0f, 0.0f, 0.0f};
                point = here;
            }
            sums.x += 1.0f;
            sums.y += length;
            sums.z += ended;
            sums.w += total;
            episode++;
            epsilon *= DECAY;
            state = length = 0;
            total = 0.0f;
            stay = q[0];
            move = q[width];
        } else {
            state = next;
            stay = action ? next_stay : value;
            move = action ? next_move : move;
        }
    }
    curve[point] = sums;
    finished[agent] = episode;
}
