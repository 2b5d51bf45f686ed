// A BodyFrame (src/mocapella/schema/mocapella.proto) in protobuf's wire format, without a protobuf library.
//
// A message is its fields in a row. A field is a tag, (number << 3 | type) as a varint, and the value: a varint (0),
// 8 bytes (1), 4 bytes (5), or a length as a varint and that many bytes (2). A field that is 0 or empty is left out.
using System;
using System.IO;
using System.Text;

namespace Mocapella.KinectV2
{
    /// <summary>One body of a frame; arrays are over the joints of the topology, in its order.</summary>
    public sealed class BodyValues
    {
        public const byte NotTracked = 0, Inferred = 1, Tracked = 2;
        /// <summary>NaN with the bits that C and Python write for it, unlike float.NaN.</summary>
        public static readonly float Missing = BitConverter.ToSingle(BitConverter.GetBytes(0x7FC00000), 0);

        public readonly int Joints;
        public ulong TrackingId;
        public byte IsTracked, ClippedEdges;
        public readonly byte[] States;
        /// <summary>Camera space x, y, z of each joint [m]; 0 where it is not tracked.</summary>
        public readonly float[] PositionsM;
        /// <summary>Depth image x, y of each joint; NaN where there is none, 0 where it is not tracked.</summary>
        public readonly float[] DepthPx;
        /// <summary>Quaternion w, x, y, z of each joint; NaN where there is none, 0 where it is not tracked.</summary>
        public readonly float[] Orientations;

        public BodyValues(int joints)
        {
            Joints = joints;
            States = new byte[joints];
            PositionsM = new float[3 * joints];
            DepthPx = new float[2 * joints];
            Orientations = new float[4 * joints];
        }
    }

    /// <summary>The values of one message.</summary>
    public sealed class FrameValues
    {
        public string Sensor = "", Topology = "kinect_v2";
        public ulong NodeId, Sequence;
        public long TimeNs, SentNs;
        public uint DepthWidthPx, DepthHeightPx;
        public float TiltRad, HeightM;
        public BodyValues[] Bodies = new BodyValues[0];
        /// <summary>Whether the optional fields depth_px and orientations are sent.</summary>
        public bool HasDepthPx = true, HasOrientations = true;
    }

    public static class BodyMessage
    {
        private const int Varint = 0, EightBytes = 1, Bytes = 2, FourBytes = 5;

        /// <summary>Encode a frame as a message.</summary>
        public static byte[] Encode(FrameValues frame)
        {
            var into = new MemoryStream();
            PutVarint(into, 1, 1); // schema_version
            PutBytes(into, 2, Encoding.UTF8.GetBytes(frame.Sensor));
            PutFixed64(into, 3, frame.NodeId);
            PutVarint(into, 4, frame.Sequence);
            PutVarint(into, 5, unchecked((ulong)frame.TimeNs));
            PutVarint(into, 6, unchecked((ulong)frame.SentNs));
            PutBytes(into, 7, Encoding.UTF8.GetBytes(frame.Topology));
            PutVarint(into, 8, frame.DepthWidthPx);
            PutVarint(into, 9, frame.DepthHeightPx);
            PutFloat(into, 10, frame.TiltRad);
            PutFloat(into, 11, frame.HeightM);
            PutBytes(into, 12, Packed(frame, body => BitConverter.GetBytes(body.TrackingId)));
            PutBytes(into, 13, Packed(frame, body => new[] { body.IsTracked }));
            PutBytes(into, 14, Packed(frame, body => new[] { body.ClippedEdges }));
            PutBytes(into, 15, Packed(frame, body => body.States));
            PutBytes(into, 16, Packed(frame, body => Floats(body.PositionsM)));
            if (frame.HasDepthPx) PutBytes(into, 17, Packed(frame, body => Floats(body.DepthPx)));
            if (frame.HasOrientations) PutBytes(into, 18, Packed(frame, body => Floats(body.Orientations)));
            return into.ToArray();
        }

        /// <summary>Return a message after its length as a varint, as it goes into a stream.</summary>
        public static byte[] Delimited(byte[] message)
        {
            var into = new MemoryStream();
            WriteVarint(into, (ulong)message.Length);
            into.Write(message, 0, message.Length);
            return into.ToArray();
        }

        private static byte[] Packed(FrameValues frame, Func<BodyValues, byte[]> bytesOf)
        {
            var into = new MemoryStream();
            foreach (var body in frame.Bodies)
            {
                var bytes = bytesOf(body);
                into.Write(bytes, 0, bytes.Length);
            }
            return into.ToArray();
        }

        // Little-endian, as every PC with a Kinect has it.
        private static byte[] Floats(float[] values)
        {
            var bytes = new byte[4 * values.Length];
            Buffer.BlockCopy(values, 0, bytes, 0, bytes.Length);
            return bytes;
        }

        private static void WriteVarint(Stream into, ulong value)
        {
            while (value > 0x7F)
            {
                into.WriteByte((byte)(value & 0x7F | 0x80)); // seven bits, and: more follow
                value >>= 7;
            }
            into.WriteByte((byte)value);
        }

        private static void PutTag(Stream into, int number, int type)
        {
            WriteVarint(into, (ulong)(number << 3 | type));
        }

        private static void PutVarint(Stream into, int number, ulong value)
        {
            if (value == 0) return;
            PutTag(into, number, Varint);
            WriteVarint(into, value);
        }

        private static void PutFixed64(Stream into, int number, ulong value)
        {
            if (value == 0) return;
            PutTag(into, number, EightBytes);
            into.Write(BitConverter.GetBytes(value), 0, 8);
        }

        private static void PutFloat(Stream into, int number, float value)
        {
            var bytes = BitConverter.GetBytes(value);
            if (BitConverter.ToInt32(bytes, 0) == 0) return;
            PutTag(into, number, FourBytes);
            into.Write(bytes, 0, 4);
        }

        private static void PutBytes(Stream into, int number, byte[] value)
        {
            if (value.Length == 0) return;
            PutTag(into, number, Bytes);
            WriteVarint(into, (ulong)value.Length);
            into.Write(value, 0, value.Length);
        }
    }
}
