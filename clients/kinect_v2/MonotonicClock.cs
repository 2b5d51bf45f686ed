using System.Diagnostics;

namespace Mocapella.KinectV2
{
    public static class MonotonicClock
    {
        /// <summary>Return the time of this machine's monotonic clock [ns].</summary>
        public static long NowNs()
        {
            long ticks = Stopwatch.GetTimestamp(), hz = Stopwatch.Frequency;
            return ticks / hz * 1000000000 + ticks % hz * 1000000000 / hz;
        }
    }
}
