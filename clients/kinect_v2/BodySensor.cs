// The Kinect v2: turns each frame of the SDK into the values of a message.
using System;
using System.Collections.Generic;
using Microsoft.Kinect;

namespace Mocapella.KinectV2
{
    /// <summary>Opens the sensor and hands over each of its frames, on a thread of the SDK.</summary>
    public sealed class BodySensor : IDisposable
    {
        private const int Joints = 25;
        /// <summary>Larger coordinates are no positions; the schema refuses them.</summary>
        private const float FarthestM = 1000f;

        private readonly KinectSensor sensor;
        private readonly BodyFrameReader reader;
        private readonly Action<FrameValues> onFrame;
        private readonly Body[] bodies;
        private readonly object gate = new object();
        private long lastTicks = long.MinValue, shiftTicks, lastSeenNs;
        private bool closed;

        /// <summary>Frames that the SDK announced and then no longer had.</summary>
        public long Missed;
        /// <summary>Frames that repeated the time of the frame before; they are left out.</summary>
        public long Repeated;
        /// <summary>Times that the sensor's clock went back, as after it was plugged in again.</summary>
        public long ClockJumps;
        /// <summary>Joints whose coordinates were no numbers; they are sent as not tracked.</summary>
        public long BadJoints;

        /// <summary>Whether the sensor runs. It may be plugged in later.</summary>
        public bool IsAvailable { get { return sensor.IsAvailable; } }

        /// <param name="onFrame">Called with each frame, without sensor name, node id and number.</param>
        /// <param name="onAvailable">Called when the sensor begins to run, and when it is unplugged.</param>
        public BodySensor(Action<FrameValues> onFrame, Action<bool> onAvailable)
        {
            this.onFrame = onFrame;
            sensor = KinectSensor.GetDefault();
            bodies = new Body[sensor.BodyFrameSource.BodyCount];
            reader = sensor.BodyFrameSource.OpenReader();
            reader.FrameArrived += OnFrameArrived;
            sensor.IsAvailableChanged += (source, change) => onAvailable(change.IsAvailable);
            sensor.Open();
        }

        /// <summary>Close the sensor; no frame is handed over afterwards.</summary>
        public void Dispose()
        {
            lock (gate)
            {
                if (closed) return;
                closed = true;
            }
            reader.Dispose();
            sensor.Close();
        }

        private void OnFrameArrived(object source, BodyFrameArrivedEventArgs arrived)
        {
            lock (gate)
            {
                if (closed) return;
                using (var frame = arrived.FrameReference.AcquireFrame())
                {
                    if (frame == null)
                    {
                        Missed++;
                        return;
                    }
                    long ticks = frame.RelativeTime.Ticks;
                    if (ticks == lastTicks)
                    {
                        Repeated++;
                        return;
                    }
                    frame.GetAndRefreshBodyData(bodies);
                    var values = new FrameValues { TimeNs = RisingNs(ticks), SentNs = MonotonicClock.NowNs() };
                    var depth = sensor.DepthFrameSource.FrameDescription;
                    values.DepthWidthPx = (uint)depth.Width;
                    values.DepthHeightPx = (uint)depth.Height;
                    SetPose(values, frame.FloorClipPlane);
                    values.Bodies = Seen();
                    onFrame(values);
                }
            }
        }

        /// <summary>Return the sensor's time [ns]; where its clock goes back, the time goes on.</summary>
        private long RisingNs(long ticks)
        {
            long now = MonotonicClock.NowNs();
            if (lastTicks != long.MinValue && ticks < lastTicks)
            {
                ClockJumps++;
                shiftTicks += lastTicks - ticks + Math.Max(1, (now - lastSeenNs) / 100);
            }
            lastTicks = ticks;
            lastSeenNs = now;
            return (ticks + shiftTicks) * 100;
        }

        /// <summary>Set tilt and height by the floor plane a·x + b·y + c·z + d = 0, all 0 where none is seen.
        /// (a, b, c) is the upward direction and d the sensor's height, so c is the sine of the tilt.</summary>
        private static void SetPose(FrameValues values, Vector4 floor)
        {
            double x = floor.X, y = floor.Y, z = floor.Z, length = Math.Sqrt(x * x + y * y + z * z);
            double height = floor.W / length;
            if (!(length > 0.5 && length < 2 && Math.Abs(height) <= FarthestM)) return;
            values.TiltRad = (float)Math.Atan2(z, Math.Sqrt(x * x + y * y));
            values.HeightM = (float)height;
        }

        private BodyValues[] Seen()
        {
            var seen = new List<BodyValues>();
            foreach (var body in bodies)
                if (body != null && body.IsTracked)
                    seen.Add(ValuesOf(body));
            return seen.ToArray();
        }

        private BodyValues ValuesOf(Body body)
        {
            var values = new BodyValues(Joints)
            {
                TrackingId = body.TrackingId, IsTracked = 1, ClippedEdges = (byte)body.ClippedEdges,
            };
            for (int j = 0; j < Joints; j++)
            {
                var joint = body.Joints[(JointType)j];
                var p = joint.Position;
                if (joint.TrackingState == TrackingState.NotTracked) continue;
                if (!(IsPosition(p.X) && IsPosition(p.Y) && IsPosition(p.Z)))
                {
                    BadJoints++;
                    continue;
                }
                values.States[j] = (byte)joint.TrackingState;
                values.PositionsM[3 * j] = p.X;
                values.PositionsM[3 * j + 1] = p.Y;
                values.PositionsM[3 * j + 2] = p.Z;

                var pixel = sensor.CoordinateMapper.MapCameraPointToDepthSpace(p);
                bool hasPixel = IsFinite(pixel.X) && IsFinite(pixel.Y);
                values.DepthPx[2 * j] = hasPixel ? pixel.X : BodyValues.Missing;
                values.DepthPx[2 * j + 1] = hasPixel ? pixel.Y : BodyValues.Missing;

                var q = body.JointOrientations[(JointType)j].Orientation; // x, y, z, w; all 0 where there is none
                bool turned = q.X != 0 || q.Y != 0 || q.Z != 0 || q.W != 0;
                bool hasTurn = turned && IsFinite(q.X) && IsFinite(q.Y) && IsFinite(q.Z) && IsFinite(q.W);
                values.Orientations[4 * j] = hasTurn ? q.W : BodyValues.Missing;
                values.Orientations[4 * j + 1] = hasTurn ? q.X : BodyValues.Missing;
                values.Orientations[4 * j + 2] = hasTurn ? q.Y : BodyValues.Missing;
                values.Orientations[4 * j + 3] = hasTurn ? q.Z : BodyValues.Missing;
            }
            return values;
        }

        private static bool IsFinite(float value)
        {
            return !float.IsNaN(value) && !float.IsInfinity(value);
        }

        private static bool IsPosition(float value)
        {
            return Math.Abs(value) <= FarthestM; // not of NaN
        }
    }
}
