// A stand-in for the parts of Microsoft.Kinect that clients/kinect_v2 uses: it plays made-up bodies.
//
// The names are those of the SDK's public interface. The bodies are formulas of the frame's number, with all that a
// real sensor has: six places for bodies, untracked ones, inferred joints, joints without a pixel or an orientation.
// Each frame is written to KINECT_STUB_LOG as one line of JSON, with floats as the bits of their 32-bit numbers.
//
//   KINECT_STUB_HZ       frames a second (30)
//   KINECT_STUB_FRAMES   number of frames, then none come (no limit)
//   KINECT_STUB_BAD      frame whose first joint is NaN, whose clock goes back, and that comes twice
//   KINECT_STUB_EMPTY    bodies are never tracked
using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Text;
using System.Threading;

namespace Microsoft.Kinect
{
    public enum TrackingState { NotTracked = 0, Inferred = 1, Tracked = 2 }

    [Flags]
    public enum FrameEdges { None = 0, Right = 1, Left = 2, Top = 4, Bottom = 8 }

    public enum JointType
    {
        SpineBase, SpineMid, Neck, Head, ShoulderLeft, ElbowLeft, WristLeft, HandLeft, ShoulderRight, ElbowRight,
        WristRight, HandRight, HipLeft, KneeLeft, AnkleLeft, FootLeft, HipRight, KneeRight, AnkleRight, FootRight,
        SpineShoulder, HandTipLeft, ThumbLeft, HandTipRight, ThumbRight,
    }

    public struct CameraSpacePoint { public float X, Y, Z; }
    public struct DepthSpacePoint { public float X, Y; }
    public struct Vector4 { public float X, Y, Z, W; }

    public struct Joint
    {
        public JointType JointType;
        public CameraSpacePoint Position;
        public TrackingState TrackingState;
    }

    public struct JointOrientation { public JointType JointType; public Vector4 Orientation; }

    public sealed class Body
    {
        internal readonly Dictionary<JointType, Joint> joints = new Dictionary<JointType, Joint>();
        internal readonly Dictionary<JointType, JointOrientation> turns = new Dictionary<JointType, JointOrientation>();

        public bool IsTracked { get; internal set; }
        public ulong TrackingId { get; internal set; }
        public FrameEdges ClippedEdges { get; internal set; }
        public IReadOnlyDictionary<JointType, Joint> Joints { get { return joints; } }
        public IReadOnlyDictionary<JointType, JointOrientation> JointOrientations { get { return turns; } }
    }

    public sealed class BodyFrame : IDisposable
    {
        internal Body[] bodies;

        public TimeSpan RelativeTime { get; internal set; }
        public Vector4 FloorClipPlane { get; internal set; }
        public int BodyCount { get { return bodies.Length; } }

        public void GetAndRefreshBodyData(IList<Body> into)
        {
            for (int i = 0; i < bodies.Length; i++) into[i] = bodies[i];
        }

        public void Dispose() { }
    }

    public sealed class BodyFrameReference
    {
        internal BodyFrame frame;

        public BodyFrame AcquireFrame() { return frame; }
    }

    public sealed class BodyFrameArrivedEventArgs : EventArgs
    {
        public BodyFrameReference FrameReference { get; internal set; }
    }

    public sealed class IsAvailableChangedEventArgs : EventArgs
    {
        public bool IsAvailable { get; internal set; }
    }

    public sealed class FrameDescription
    {
        public int Width { get { return 512; } }
        public int Height { get { return 424; } }
    }

    public sealed class DepthFrameSource
    {
        public FrameDescription FrameDescription { get { return new FrameDescription(); } }
    }

    public sealed class CoordinateMapper
    {
        // Nothing nearer than 1.6 m is in this depth image.
        public DepthSpacePoint MapCameraPointToDepthSpace(CameraSpacePoint p)
        {
            if (p.Z < 1.6f)
                return new DepthSpacePoint { X = float.NegativeInfinity, Y = float.NegativeInfinity };
            return new DepthSpacePoint { X = 256 + 365 * p.X / p.Z, Y = 212 - 365 * p.Y / p.Z };
        }
    }

    public sealed class BodyFrameSource
    {
        internal KinectSensor sensor;

        public int BodyCount { get { return 6; } }

        public BodyFrameReader OpenReader() { return sensor.reader; }
    }

    public sealed class BodyFrameReader : IDisposable
    {
        public event EventHandler<BodyFrameArrivedEventArgs> FrameArrived;

        internal void Raise(BodyFrame frame)
        {
            var handler = FrameArrived;
            var reference = new BodyFrameReference { frame = frame };
            if (handler != null) handler(this, new BodyFrameArrivedEventArgs { FrameReference = reference });
        }

        public void Dispose() { FrameArrived = null; }
    }

    public sealed class KinectSensor
    {
        private static readonly KinectSensor only = new KinectSensor();
        internal readonly BodyFrameReader reader = new BodyFrameReader();
        private readonly int hz = Setting("KINECT_STUB_HZ", 30), bad = Setting("KINECT_STUB_BAD", -1);
        private readonly int frames = Setting("KINECT_STUB_FRAMES", int.MaxValue);
        private readonly bool empty = Setting("KINECT_STUB_EMPTY", 0) != 0;
        private StreamWriter log;
        private volatile bool open;

        public static KinectSensor GetDefault() { return only; }

        private KinectSensor()
        {
            BodyFrameSource = new BodyFrameSource { sensor = this };
            DepthFrameSource = new DepthFrameSource();
            CoordinateMapper = new CoordinateMapper();
        }

        public BodyFrameSource BodyFrameSource { get; private set; }
        public DepthFrameSource DepthFrameSource { get; private set; }
        public CoordinateMapper CoordinateMapper { get; private set; }
        public bool IsAvailable { get { return open; } }
        public event EventHandler<IsAvailableChangedEventArgs> IsAvailableChanged;

        public void Open()
        {
            string path = Environment.GetEnvironmentVariable("KINECT_STUB_LOG");
            if (!string.IsNullOrEmpty(path)) log = new StreamWriter(path, true) { AutoFlush = true };
            open = true;
            var changed = IsAvailableChanged;
            if (changed != null) changed(this, new IsAvailableChangedEventArgs { IsAvailable = true });
            new Thread(Play) { IsBackground = true }.Start();
        }

        public void Close() { open = false; }

        private static int Setting(string name, int otherwise)
        {
            int value;
            return int.TryParse(Environment.GetEnvironmentVariable(name), out value) ? value : otherwise;
        }

        private void Play()
        {
            var watch = System.Diagnostics.Stopwatch.StartNew();
            for (int k = 0; open && k < frames; k++)
            {
                while (open && watch.Elapsed.TotalSeconds * hz < k) Thread.Sleep(1);
                var frame = Made(k);
                if (log != null) log.WriteLine(Line(k, frame));
                reader.Raise(frame);
                if (k == bad) reader.Raise(frame);
            }
        }

        private BodyFrame Made(int k)
        {
            var bodies = new Body[6];
            for (int b = 0; b < 6; b++) bodies[b] = Made(k, b);
            long ticks = 12345678 + 333333L * k - (bad >= 0 && k >= bad ? 10000000 : 0);
            bool floor = k % 4 != 3; // in every fourth frame no floor is seen
            return new BodyFrame
            {
                bodies = bodies,
                RelativeTime = TimeSpan.FromTicks(ticks),
                FloorClipPlane = floor
                    ? new Vector4 { X = 0.02f, Y = 0.97f, Z = -0.2f + 0.001f * (k % 50), W = 1.25f + 0.001f * (k % 7) }
                    : new Vector4(),
            };
        }

        private Body Made(int k, int b)
        {
            // Places 1 and 4 have bodies; another comes and goes in place 2.
            bool tracked = !empty && (b == 1 || b == 4 || b == 2 && k / 15 % 2 == 1);
            var body = new Body
            {
                IsTracked = tracked,
                TrackingId = tracked ? 72057594037927936UL + (ulong)b : 0,
                ClippedEdges = tracked ? (FrameEdges)((k + b) % 16) : FrameEdges.None,
            };
            for (int j = 0; j < 25; j++)
            {
                var state = !tracked || (k + j + b) % 11 == 0 ? TrackingState.NotTracked
                    : (k + j) % 5 == 0 ? TrackingState.Inferred : TrackingState.Tracked;
                var p = new CameraSpacePoint
                {
                    X = b - 2.5f + 0.01f * j + 0.001f * (k % 100), Y = 1 - 0.08f * j, Z = 1.5f + 0.03f * j + 0.1f * b,
                };
                if (k == bad && j == 0) p.X = float.NaN;
                if (!tracked) p = new CameraSpacePoint();
                var q = new Vector4 { X = 0.5f, Y = -0.5f, Z = 0.5f, W = j % 2 == 0 ? 0.5f : -0.5f };
                if (!tracked || j == 3 || j == 15 || j == 19 || j > 20) q = new Vector4(); // ends of limbs have none
                body.joints[(JointType)j] = new Joint { JointType = (JointType)j, Position = p, TrackingState = state };
                body.turns[(JointType)j] = new JointOrientation { JointType = (JointType)j, Orientation = q };
            }
            return body;
        }

        private string Line(int k, BodyFrame frame)
        {
            var line = new StringBuilder();
            var f = frame.FloorClipPlane;
            line.Append("{\"k\": " + k + ", \"ticks\": " + frame.RelativeTime.Ticks + ", \"floor\": ");
            Add(line, f.X, f.Y, f.Z, f.W);
            line.Append(", \"bodies\": [");
            for (int b = 0; b < 6; b++)
            {
                var body = frame.bodies[b];
                line.Append((b > 0 ? ", " : "") + "{\"tracked\": " + (body.IsTracked ? 1 : 0));
                line.Append(", \"id\": " + body.TrackingId + ", \"edges\": " + (int)body.ClippedEdges);
                line.Append(", \"joints\": [");
                for (int j = 0; j < 25; j++)
                {
                    var joint = body.joints[(JointType)j];
                    var p = joint.Position;
                    var d = CoordinateMapper.MapCameraPointToDepthSpace(p);
                    var q = body.turns[(JointType)j].Orientation;
                    line.Append((j > 0 ? ", " : "") + "[" + (int)joint.TrackingState + ", ");
                    Add(line, p.X, p.Y, p.Z, d.X, d.Y, q.W, q.X, q.Y, q.Z);
                    line.Append("]");
                }
                line.Append("]}");
            }
            return line.Append("]}").ToString();
        }

        private static void Add(StringBuilder line, params float[] values)
        {
            var bits = new List<string>();
            foreach (float value in values)
                bits.Add(BitConverter.ToInt32(BitConverter.GetBytes(value), 0).ToString(CultureInfo.InvariantCulture));
            line.Append("[" + string.Join(", ", bits.ToArray()) + "]");
        }
    }
}
